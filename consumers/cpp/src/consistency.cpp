#include "consistency.hpp"

#include "errors.hpp"

namespace duospacenet {
namespace {

using Specs = std::map<std::string, TensorSpec>;

[[noreturn]] void refuse(const std::string& tensor, const std::string& expected, const std::string& got) {
    throw ArtifactError("manifest.json: " + tensor + ": expected " + expected + "; got " + got + ". Export again.");
}

void add(Specs& specs, const std::string& name, Shape shape, Dtype dtype = Dtype::float32) {
    specs.insert_or_assign(name, TensorSpec{name, std::move(shape), dtype});
}

/// Compares the inputs of a graph with the tensors that it will get.
void check_inputs(const GraphSpec& graph, const Specs& available) {
    for (const TensorSpec& input : graph.inputs) {
        const auto found = available.find(input.name);
        const std::string expected = describe(input.shape, input.dtype) + ", as the graph takes";
        const std::string name = "graph " + graph.name + ", input " + input.name;
        if (found == available.end()) refuse(name, expected, "no such tensor");
        if (found->second != input) refuse(name, expected, describe(found->second.shape, found->second.dtype));
    }
}

const TensorSpec& output_of(const GraphSpec& graph, const std::string& name) {
    for (const TensorSpec& output : graph.outputs) {
        if (output.name == name) return output;
    }
    refuse("graph " + graph.name, "an output " + name, "none");
}

/// The images of the backbone, of a part of the cameras. Adds its outputs, of all cameras, to the features.
void check_backbone(const Manifest& manifest, Specs& features) {
    const GraphSpec& backbone = manifest.graphs.at("backbone");
    const auto size = [](int pixels) { return static_cast<std::size_t>(pixels); };
    const auto num_cameras = static_cast<std::size_t>(manifest.num_cameras);
    const bool has_images = backbone.inputs.size() == 1 && !backbone.inputs[0].shape.empty();
    const std::size_t group = has_images ? backbone.inputs[0].shape[0] : 1;
    if (num_cameras % group != 0) {
        refuse("num_cameras", "a multiple of " + std::to_string(group) + ", the images of the backbone",
               std::to_string(num_cameras));
    }
    Specs images;
    add(images, "images", {group, size(manifest.preprocessing.height_px), size(manifest.preprocessing.width_px), 3},
        Dtype::uint8);
    check_inputs(backbone, images);
    for (const TensorSpec& output : backbone.outputs) {
        Shape shape = output.shape;
        if (shape.empty() || shape[0] != group) refuse(output.name, "one row per image", describe(shape, output.dtype));
        shape[0] = num_cameras;
        add(features, output.name, shape, output.dtype);
    }
}

Specs decoder_inputs(const Manifest& manifest, const Specs& features) {
    const auto num_frames = static_cast<std::size_t>(manifest.window.num_frames);
    const auto num_cameras = static_cast<std::size_t>(manifest.num_cameras);
    Specs inputs;
    add(inputs, "image_T_ego", {num_frames, num_cameras, 3, 4});
    add(inputs, "past_T_now", {num_frames, 4, 4});
    add(inputs, "time_delta_s", {num_frames});
    add(inputs, "frame_valid", {num_frames}, Dtype::boolean);
    add(inputs, "camera_valid", {num_frames, num_cameras}, Dtype::boolean);
    for (const std::string& name : manifest.memory) {
        const auto value = features.find(name);
        if (value == features.end()) refuse("memory", "outputs of the backbone and the lifter", name);
        for (std::size_t slot = 0; slot < num_frames; ++slot) {
            add(inputs, "slot" + std::to_string(slot) + "." + name, value->second.shape, value->second.dtype);
        }
    }
    return inputs;
}

void check_detections(const Manifest& manifest) {
    const GraphSpec& decoder = manifest.graphs.at("decoder");
    const TensorSpec& logits = output_of(decoder, "class_logits");
    const std::size_t num_queries = logits.shape.empty() ? 0 : logits.shape[0];
    const TensorSpec expected_logits{"class_logits", {num_queries, manifest.classes.size()}, Dtype::float32};
    const TensorSpec expected_boxes{"boxes", {num_queries, 9}, Dtype::float32};
    for (const TensorSpec& expected : {expected_logits, expected_boxes}) {
        const TensorSpec& found = output_of(decoder, expected.name);
        if (found != expected) {
            refuse(expected.name, describe(expected.shape, expected.dtype), describe(found.shape, found.dtype));
        }
    }
}

}  // namespace

void check_consistency(const Manifest& manifest) {
    const auto num_cameras = static_cast<std::size_t>(manifest.num_cameras);
    Specs features;
    check_backbone(manifest, features);
    if (manifest.has_graph("lifter")) {
        Specs projector_inputs;
        add(projector_inputs, "image_T_ego", {num_cameras, 3, 4});
        add(projector_inputs, "camera_valid", {num_cameras}, Dtype::boolean);
        check_inputs(manifest.graphs.at("projector"), projector_inputs);
        Specs lifter_inputs = features;
        for (const TensorSpec& output : manifest.graphs.at("projector").outputs) lifter_inputs[output.name] = output;
        check_inputs(manifest.graphs.at("lifter"), lifter_inputs);
        for (const TensorSpec& output : manifest.graphs.at("lifter").outputs) features[output.name] = output;
    }
    check_inputs(manifest.graphs.at("decoder"), decoder_inputs(manifest, features));
    check_detections(manifest);
    if (!manifest.has_graph("segmenter")) return;
    check_inputs(manifest.graphs.at("segmenter"), features);
    for (const std::string& name : manifest.map_classes) {
        const TensorSpec& mask = output_of(manifest.graphs.at("segmenter"), name);
        const bool is_mask = mask.shape.size() == 4 && mask.shape[0] * mask.shape[1] == 1;
        if (!is_mask) refuse(name, "a mask (1, 1, X, Y)", describe(mask.shape, mask.dtype));
    }
}

}  // namespace duospacenet
