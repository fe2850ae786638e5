#include "pipeline.hpp"

#include <algorithm>
#include <cstring>

#include "consistency.hpp"
#include "geometry.hpp"
#include "validation.hpp"

namespace duospacenet {
namespace {

/// Views `count` elements of the first axis of a tensor, from `first` on, by copying them.
Tensor slice(const Tensor& tensor, std::size_t first, std::size_t count) {
    Shape shape = tensor.shape();
    shape[0] = count;
    Tensor part(shape, tensor.dtype());
    const std::size_t bytes = part.size() * size_in_bytes(part.dtype());
    std::memcpy(part.bytes(), tensor.bytes() + first / count * bytes, bytes);
    return part;
}

bool is_lost(const Camera& camera) { return camera.is_lost(); }

Tensors cached(const Tensors& features, const std::vector<std::string>& names) {
    Tensors memory;
    for (const std::string& name : names) memory.emplace(name, features.at(name));
    return memory;
}

}  // namespace

Pipeline::Pipeline(const std::filesystem::path& bundle, int threads) : manifest_(read_manifest(bundle)) {
    check_consistency(manifest_);
    for (const auto& [name, spec] : manifest_.graphs) {
        graphs_.emplace(name, load_graph(read_graph(bundle, spec), spec, manifest_, threads));
    }
}

Tensors Pipeline::run(const std::string& graph, const Tensors& tensors) {
    return graph == "backbone" ? run_backbone(tensors) : graphs_.at(graph)->run(tensors);
}

/// Runs the backbone for groups of as many cameras as it takes at a time, and concatenates the outputs.
Tensors Pipeline::run_backbone(const Tensors& tensors) {
    const GraphSpec& spec = manifest_.graphs.at("backbone");
    const auto num_cameras = static_cast<std::size_t>(manifest_.num_cameras);
    const std::size_t group = spec.inputs.at(0).shape.at(0);
    if (group == num_cameras) return graphs_.at("backbone")->run(tensors);
    Tensors outputs;
    for (const TensorSpec& output : spec.outputs) {
        Shape shape = output.shape;
        shape.at(0) = num_cameras;
        outputs.emplace(output.name, Tensor::zeros(shape, output.dtype));
    }
    const auto valid = tensors.at("camera_valid").values<bool>();
    for (std::size_t first = 0; first < num_cameras; first += group) {
        const auto cameras = valid.subspan(first, group);
        // The other graphs mask the features of lost cameras, so a group of them need not run.
        if (std::none_of(cameras.begin(), cameras.end(), [](bool is_valid) { return is_valid; })) continue;
        for (const auto& [name, part] :
             graphs_.at("backbone")->run({{"images", slice(tensors.at("images"), first, group)}})) {
            const std::size_t bytes = part.size() * size_in_bytes(part.dtype());
            std::memcpy(outputs.at(name).bytes() + first / group * bytes, part.bytes(), bytes);
        }
    }
    return outputs;
}

Stream::Stream(Pipeline& pipeline, StreamOptions options)
    : pipeline_(&pipeline), options_(std::move(options)), history_(pipeline.manifest()) {}

Detections Stream::step(const Frame& frame) {
    const Manifest& manifest = pipeline_->manifest();
    check_frame(frame, manifest.num_cameras);
    Detections detections;
    detections.reset_reason = history_.reset_reason(frame);
    if (std::all_of(frame.cameras.begin(), frame.cameras.end(), is_lost)) {
        detections.reset_reason.reset();
        detections.skipped = "every camera is lost";
        return detections;
    }
    History history = detections.reset_reason ? History(manifest) : history_;

    const NetworkInputs inputs = prepare(frame, manifest.preprocessing, manifest.num_cameras);
    const Tensors features = encode(inputs);
    PastFrame now{frame.scene,        frame.timestamp_s,   nearest_rigid(frame.global_T_ego),
                  inputs.image_T_ego, inputs.camera_valid, cached(features, manifest.memory)};
    const Tensors outputs = run("decoder", history.decoder_inputs(now));
    detections.boxes = select_detections(outputs.at("class_logits"), outputs.at("boxes"), detections.dropped_queries);
    detections.ages_s = history.ages_s(frame.timestamp_s);
    if (options_.maps && manifest.has_graph("segmenter")) segment(features, detections);

    // The history changes only here, so a step that fails leaves the stream unchanged.
    history.add(std::move(now));
    history_ = std::move(history);
    return detections;
}

/// Runs a graph, and shows the tensors to the observer.
Tensors Stream::run(const std::string& graph, const Tensors& tensors) {
    observe_inputs(graph, tensors);
    Tensors outputs = pipeline_->run(graph, tensors);
    observe(graph + ".", outputs);
    return outputs;
}

void Stream::observe_inputs(const std::string& graph, const Tensors& tensors) const {
    if (!options_.observer || graph == "lifter" || graph == "segmenter") return;  // these take outputs of graphs only
    const auto takes = [&](const std::string& name, const std::string& input) {
        const auto& inputs = pipeline_->manifest().graphs.at(name).inputs;
        return std::any_of(inputs.begin(), inputs.end(), [&](const TensorSpec& spec) { return spec.name == input; });
    };
    for (const auto& [name, tensor] : tensors) {
        const bool decoder_takes_it = graph != "decoder" && takes("decoder", name);
        if (takes(graph, name) && !decoder_takes_it) options_.observer("inputs." + name, tensor);
    }
}

void Stream::observe(const std::string& prefix, const Tensors& tensors) const {
    if (!options_.observer) return;
    for (const auto& [name, tensor] : tensors) options_.observer(prefix + name, tensor);
}

/// The outputs of the backbone and the lifter: PV and BEV features, and the values to cache.
Tensors Stream::encode(const NetworkInputs& inputs) {
    Tensors features = run("backbone", {{"images", inputs.images}, {"camera_valid", inputs.camera_valid}});
    if (pipeline_->manifest().has_graph("lifter")) {
        Tensors lifter_inputs = features;
        for (const auto& table : lifting_tables(inputs)) lifter_inputs.insert(table);
        features.merge(run("lifter", lifter_inputs));
    }
    return features;
}

/// The sampling tables of the lifter. The projector runs only if its inputs have changed.
const Tensors& Stream::lifting_tables(const NetworkInputs& inputs) {
    const Tensors tensors{{"image_T_ego", inputs.image_T_ego}, {"camera_valid", inputs.camera_valid}};
    observe_inputs("projector", tensors);
    const bool is_same = projector_run_ && projector_run_->image_T_ego == inputs.image_T_ego &&
                         projector_run_->camera_valid == inputs.camera_valid;
    if (!is_same) {
        projector_run_ = ProjectorRun{inputs.image_T_ego, inputs.camera_valid, pipeline_->run("projector", tensors)};
    }
    observe("projector.", projector_run_->outputs);
    return projector_run_->outputs;
}

void Stream::segment(const Tensors& features, Detections& detections) {
    for (const auto& [name, mask] : run("segmenter", features)) {
        detections.maps.emplace(name, probabilities(mask, detections.dropped_map_cells));
    }
    observe("maps.", detections.maps);
}

}  // namespace duospacenet
