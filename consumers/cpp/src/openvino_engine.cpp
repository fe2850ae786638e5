#include <openvino/frontend/manager.hpp>
#include <openvino/openvino.hpp>
#include <sstream>

#include "engine.hpp"
#include "errors.hpp"

namespace duospacenet {
namespace {

ov::Core& core() {
    static ov::Core instance;
    return instance;
}

/// Reads a graph as ONNX. `Core::read_model` would try every format that OpenVINO knows.
std::shared_ptr<ov::Model> read_model(const std::string& content) {
    static ov::frontend::FrontEndManager manager;
    const auto frontend = manager.load_by_framework("onnx");
    std::istringstream stream(content);
    return frontend->convert(frontend->load(static_cast<std::istream*>(&stream)));
}

ov::AnyMap options(int threads) {
    // float32 on every CPU: OpenVINO would take bfloat16 where the CPU has it, which is another precision.
    return {ov::hint::inference_precision(ov::element::f32), ov::num_streams(1), ov::inference_num_threads(threads),
            ov::hint::enable_cpu_pinning(false)};
}

ov::element::Type element_type(Dtype dtype) {
    return dtype == Dtype::float32 ? ov::element::f32 : dtype == Dtype::uint8 ? ov::element::u8 : ov::element::boolean;
}

/// An input or output of a loaded graph. Of several names of a tensor, the manifest's is preferred.
TensorSpec describe_port(const ov::Output<const ov::Node>& port, const TensorSpec& expected) {
    const std::string name = port.get_names().contains(expected.name) ? expected.name : port.get_any_name();
    const bool same_type = port.get_element_type() == element_type(expected.dtype);
    const Dtype other = expected.dtype == Dtype::float32 ? Dtype::uint8 : Dtype::float32;
    return {name, port.get_shape(), same_type ? expected.dtype : other};
}

void check_ports(const std::string& graph, const std::vector<ov::Output<const ov::Node>>& ports,
                 const std::vector<TensorSpec>& specs) {
    if (ports.size() != specs.size()) {
        throw ArtifactError(graph + ".onnx: expected " + std::to_string(specs.size()) + " inputs or outputs, as " +
                            "manifest.json says; the graph has " + std::to_string(ports.size()) + ". Export again.");
    }
    for (std::size_t index = 0; index < specs.size(); ++index) {
        check_tensor(graph, specs[index], describe_port(ports[index], specs[index]));
    }
}

/// The forms of a bundle that OpenVINO cannot run, or nothing, for a message.
std::string advice(const Manifest& manifest) {
    if (manifest.dcn == "native") return "OpenVINO has no operator DeformConv: export with `--dcn grid-sample`.";
    if (manifest.attention == "compact") {
        return "The bundle has the compact form, with dynamic shapes: export with `--attention grid-sample`.";
    }
    return "Export again, with `--attention grid-sample`.";
}

/// The message of an exception on one line, without the source files of OpenVINO that it names.
std::string message_of(const std::exception& error) {
    std::istringstream lines(error.what());
    std::string message, line;
    while (std::getline(lines, line)) {
        if (!line.empty() && !line.starts_with("Exception from ")) message += (message.empty() ? "" : " ") + line;
    }
    return message;
}

class OpenvinoGraph : public Graph {
  public:
    OpenvinoGraph(ov::CompiledModel model, GraphSpec spec)
        : model_(std::move(model)), request_(model_.create_infer_request()), spec_(std::move(spec)) {}

    Tensors run(const Tensors& inputs) override {
        // The outputs get memory of their own in every run: those of earlier runs are cached.
        Tensors outputs;
        for (const TensorSpec& output : spec_.outputs) outputs.emplace(output.name, Tensor(output.shape, output.dtype));
        try {
            for (std::size_t index = 0; index < spec_.inputs.size(); ++index) {
                request_.set_input_tensor(index, share(input_of(spec_.name, spec_.inputs[index], inputs)));
            }
            for (std::size_t index = 0; index < spec_.outputs.size(); ++index) {
                request_.set_output_tensor(index, share(outputs.at(spec_.outputs[index].name)));
            }
            request_.infer();
        } catch (const ov::Exception& error) {
            throw ArtifactError(spec_.name + ".onnx: the graph failed to run: " + message_of(error));
        }
        return outputs;
    }

  private:
    static ov::Tensor share(const Tensor& tensor) {
        return ov::Tensor(element_type(tensor.dtype()), tensor.shape(), tensor.bytes());
    }

    ov::CompiledModel model_;
    ov::InferRequest request_;
    GraphSpec spec_;
};

}  // namespace

std::unique_ptr<Graph> load_graph(const std::string& content, const GraphSpec& spec, const Manifest& manifest,
                                  int threads) {
    try {
        ov::CompiledModel model = core().compile_model(read_model(content), "CPU", options(threads));
        check_ports(spec.name, model.inputs(), spec.inputs);
        check_ports(spec.name, model.outputs(), spec.outputs);
        return std::make_unique<OpenvinoGraph>(std::move(model), spec);
    } catch (const ov::Exception& error) {
        throw ArtifactError(spec.name + ".onnx: OpenVINO refuses the graph. " + advice(manifest) +
                            " OpenVINO says: " + message_of(error));
    }
}

std::string engine_name() { return "OpenVINO " + std::string(ov::get_openvino_version().buildNumber); }

}  // namespace duospacenet
