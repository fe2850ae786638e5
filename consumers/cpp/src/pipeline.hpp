// A loaded bundle, and the streams that run it.
#pragma once

#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>

#include "bundle.hpp"
#include "detections.hpp"
#include "engine.hpp"
#include "frame.hpp"
#include "history.hpp"
#include "tensor.hpp"

namespace duospacenet {

/// The manifest and the loaded graphs of a bundle. Its streams are used by one thread at a time.
class Pipeline {
  public:
    /// Checks a bundle's folder and loads its graphs. Throws ArtifactError.
    Pipeline(const std::filesystem::path& bundle, int threads);

    const Manifest& manifest() const { return manifest_; }

    /// Runs a graph on the tensors that it names. The backbone takes the images of all cameras.
    Tensors run(const std::string& graph, const Tensors& tensors);

  private:
    Tensors run_backbone(const Tensors& tensors);

    Manifest manifest_;
    std::map<std::string, std::unique_ptr<Graph>> graphs_;
};

/// Gets each tensor that a stream computes: `inputs.NAME` before the graphs, `GRAPH.NAME` of a graph, and `maps.NAME`.
/// An input of projector and decoder is the decoder's.
using Observer = std::function<void(const std::string& name, const Tensor& tensor)>;

struct StreamOptions {
    bool maps = false;  // also compute the map probabilities
    Observer observer;  // for `verify`
};

/// The frames of one vehicle in time order. Keeps the cached values of past frames, and resets them by the rules of
/// the bundle.
class Stream {
  public:
    /// The pipeline must outlive the stream.
    explicit Stream(Pipeline& pipeline, StreamOptions options = {});

    /// Detects the objects of one frame. A frame without any image is skipped.
    /// Throws InputError for an invalid frame, or for a time stamp that is not later than the last one of its scene.
    /// The history does not change then.
    Detections step(const Frame& frame);

    /// Drops the history. The next frame gives the same result as the first frame of a new stream.
    void reset() { history_ = History(pipeline_->manifest()); }

  private:
    struct ProjectorRun {
        Tensor image_T_ego, camera_valid;  // its inputs
        Tensors outputs;
    };

    Tensors run(const std::string& graph, const Tensors& tensors);
    void observe_inputs(const std::string& graph, const Tensors& tensors) const;
    void observe(const std::string& prefix, const Tensors& tensors) const;
    Tensors encode(const NetworkInputs& inputs);
    const Tensors& lifting_tables(const NetworkInputs& inputs);
    void segment(const Tensors& features, Detections& detections);

    Pipeline* pipeline_;
    StreamOptions options_;
    History history_;
    std::optional<ProjectorRun> projector_run_;
};

}  // namespace duospacenet
