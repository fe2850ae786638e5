// Checks that a manifest agrees with the inputs and outputs of its own graphs.
#pragma once

#include "bundle.hpp"

namespace duospacenet {

/// Follows the tensors of a frame through the graphs, and compares each input of a graph with what it will get: the
/// tensors of the host, the outputs of other graphs, and the cached values. Throws ArtifactError, naming the tensor.
void check_consistency(const Manifest& manifest);

}  // namespace duospacenet
