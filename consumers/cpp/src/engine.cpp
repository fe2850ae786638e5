#include "engine.hpp"

#include "errors.hpp"

namespace duospacenet {

const Tensor& input_of(const std::string& graph, const TensorSpec& spec, const Tensors& inputs) {
    const auto found = inputs.find(spec.name);
    const bool fits =
        found != inputs.end() && found->second.shape() == spec.shape && found->second.dtype() == spec.dtype;
    if (fits) return found->second;
    const std::string got = found == inputs.end() ? "none" : describe(found->second.shape(), found->second.dtype());
    throw ArtifactError("manifest.json: graph " + graph + ": input " + spec.name + ": expected " +
                        describe(spec.shape, spec.dtype) + "; the frame and the other graphs give " + got +
                        ". Export again.");
}

void check_tensor(const std::string& graph, const TensorSpec& expected, const TensorSpec& found) {
    if (found == expected) return;
    throw ArtifactError(graph + ".onnx: expected " + expected.name + " " + describe(expected.shape, expected.dtype) +
                        ", as manifest.json says; the graph has " + found.name + " " +
                        describe(found.shape, found.dtype) + ". Export again.");
}

}  // namespace duospacenet
