// The golden example of a bundle: a few frames, and the numbers that a consumer must compute from them.
#pragma once

#include <filesystem>

#include "pipeline.hpp"

namespace duospacenet {

/// Runs the golden example from a cold start, and compares every sampled value of the host's and the graphs' tensors,
/// and the boxes. Returns the number of compared values.
/// Throws CheckError, naming frame, tensor and element, for the first difference, and ArtifactError if the example is
/// missing or damaged.
std::size_t verify(const std::filesystem::path& bundle, Pipeline& pipeline);

}  // namespace duospacenet
