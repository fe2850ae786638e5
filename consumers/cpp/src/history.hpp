// The temporal history of one stream: cached values of past frames, reset rules and relative poses.
#pragma once

#include <deque>
#include <optional>
#include <string>
#include <vector>

#include "bundle.hpp"
#include "frame.hpp"
#include "preprocessing.hpp"
#include "tensor.hpp"

namespace duospacenet {

/// A processed frame, with the values that later frames need.
struct PastFrame {
    std::string scene;
    double timestamp_s;
    cv::Matx44d global_T_ego;  // made exactly rigid
    Tensor image_T_ego;        // (N, 3, 4)
    Tensor camera_valid;       // (N)
    Tensors memory;            // by the names of the manifest's `memory`
};

/// The past frames, newest first. Copies share the cached values.
class History {
  public:
    explicit History(const Manifest& manifest) : manifest_(&manifest) {}

    /// Why a frame cannot continue this history; nothing if it can.
    /// Throws InputError for a time stamp that is not later than the newest frame's in the same scene.
    std::optional<std::string> reset_reason(const Frame& frame) const;

    /// The decoder's inputs for the frame `now`: slot 0 has this frame, slot t the t-th frame before it.
    Tensors decoder_inputs(const PastFrame& now) const;

    /// The ages of the past frames in the window of a frame [s], newest first.
    std::vector<double> ages_s(double timestamp_s) const;

    /// Makes `now` the newest frame. Frames that no later window needs are removed.
    void add(PastFrame now);

  private:
    Tensors cached_values(const PastFrame& now) const;

    const Manifest* manifest_;
    std::deque<PastFrame> past_;
};

}  // namespace duospacenet
