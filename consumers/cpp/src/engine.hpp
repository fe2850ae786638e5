// A graph in an engine. The only one is in openvino_engine.cpp; README.md says how to add another.
#pragma once

#include <memory>
#include <string>

#include "bundle.hpp"
#include "tensor.hpp"

namespace duospacenet {

/// One loaded graph. It is used by one thread at a time.
class Graph {
  public:
    virtual ~Graph() = default;

    /// Runs the graph, and returns its outputs by name as new tensors.
    /// inputs: must have the graph's inputs by name; other tensors are ignored. They are used without a copy.
    /// Throws ArtifactError if the graph fails.
    virtual Tensors run(const Tensors& inputs) = 0;
};

/// Loads a graph, and compares its inputs and outputs with the manifest.
/// content: the bytes of the file. threads: at most this many threads run the graph.
/// Throws ArtifactError.
std::unique_ptr<Graph> load_graph(const std::string& content, const GraphSpec& spec, const Manifest& manifest,
                                  int threads);

/// Name and version of the engine.
std::string engine_name();

/// The input of a graph with the name and the shape of `spec`. Throws ArtifactError if it is missing or has another
/// one.
const Tensor& input_of(const std::string& graph, const TensorSpec& spec, const Tensors& inputs);

/// Compares an input or output of a loaded graph with the manifest. Throws ArtifactError.
void check_tensor(const std::string& graph, const TensorSpec& expected, const TensorSpec& found);

}  // namespace duospacenet
