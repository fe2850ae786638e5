"""OpenVINO's own runtime as an engine. It needs the extra `openvino`.

The base installation lacks it, so only `engine` imports this module, and only when OpenVINO was chosen.
"""

import io
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path

import onnxruntime as ort

from .bundle.manifest import GraphSpec, TensorSpec
from .errors import ArtifactError
from .extras import needs_extra
from .printable import printable
from .session import TensorDescription, Tensors, check_tensors
from .telemetry import without_openvino_telemetry
from .termination import terminable

with needs_extra("openvino"), without_openvino_telemetry():
    import openvino
    from openvino.frontend import FrontEndManager

_DTYPES = {"f32": "float32", "bf16": "bfloat16", "f16": "float16", "u8": "uint8", "boolean": "bool"}


class OpenvinoSession:
    """A graph in OpenVINO; see `session.Session`."""

    def __init__(self, graph: bytes, spec: GraphSpec, path: Path, threads: int, precision: str | None) -> None:
        """Load a graph and compare its inputs and outputs with `spec`.

        graph: the content of its file, which has been checked. path: the file, for messages.
        threads: threads of a run. OpenVINO uses at most one per core.
        precision: OpenVINO's name of a number format, for example "f32"; None for OpenVINO's own choice on this CPU.
        Raises ArtifactError if OpenVINO rejects the graph, or if a name, shape or dtype differs.
        """
        try:
            self._model = _core().compile_model(_read(graph), "CPU", _options(threads, precision))
            inputs, outputs = _describe(self._model.inputs, spec.inputs), _describe(self._model.outputs, spec.outputs)
        except Exception as error:  # OpenVINO's exceptions are RuntimeErrors, or private
            raise ArtifactError(_refusal(path, graph, error)) from error
        check_tensors(path, "inputs", inputs, spec.inputs)
        check_tensors(path, "outputs", outputs, spec.outputs)
        self._path, self._spec = path, spec

    @property
    def precision(self) -> str:
        """Number format in which float operators are computed, such as "bfloat16". Some operators stay in float32."""
        name = self._model.get_property("INFERENCE_PRECISION_HINT").get_type_name()
        return _DTYPES.get(name, name)

    def run(self, tensors: Mapping[str, ort.OrtValue]) -> Tensors:
        """Run the graph; see `session.Session.run`."""
        # A request used again would write over the outputs of its last run, which a stream may have cached.
        request = self._model.create_infer_request()
        outputs = {tensor.name: _new_tensor(tensor) for tensor in self._spec.outputs}
        for index, tensor in enumerate(self._spec.inputs):
            request.set_input_tensor(index, _share(tensors[tensor.name]))
        for index, value in enumerate(outputs.values()):
            request.set_output_tensor(index, _share(value))
        try:
            with terminable(request.cancel):
                request.infer(share_outputs=True)
        except Exception as error:  # see __init__
            raise ArtifactError(f"{self._path}: the graph failed to run: {_message(error)}") from error
        return outputs


@cache
def _core() -> "openvino.Core":
    return openvino.Core()


def _options(threads: int, precision: str | None) -> dict[str, object]:
    # One stream: runs of several threads wait for each other, because each of them uses all cores. No pinning: the
    # threads of two processes could be pinned to the same core while another one is idle.
    options: dict[str, object] = {"NUM_STREAMS": 1, "INFERENCE_NUM_THREADS": threads, "ENABLE_CPU_PINNING": False}
    return options if precision is None else options | {"INFERENCE_PRECISION_HINT": precision}


def _read(graph: bytes) -> "openvino.Model":
    """Read a graph as ONNX. `Core.read_model` would try every format that OpenVINO knows."""
    frontend = FrontEndManager().load_by_framework("onnx")
    return frontend.convert(frontend.load(io.BytesIO(graph)))


def _describe(ports: Iterable, specified: Iterable[TensorSpec]) -> list[TensorDescription]:
    """Name, shape and dtype of each input or output. Of several names of a tensor, the manifest's is preferred."""
    names = [tensor.name for tensor in specified]
    descriptions = []
    for index, port in enumerate(ports):
        known = names[index] if index < len(names) and names[index] in port.get_names() else port.get_any_name()
        dtype = port.get_element_type().get_type_name()
        descriptions.append((known, tuple(port.get_shape()), _DTYPES.get(dtype, dtype)))
    return descriptions


def _new_tensor(spec: TensorSpec) -> ort.OrtValue:
    # onnxruntime owns the memory. An OrtValue from a numpy array would leave its own `numpy()` with a dangling pointer.
    return ort.OrtValue.ortvalue_from_shape_and_type(spec.shape, spec.dtype)


def _share(value: ort.OrtValue) -> "openvino.Tensor":
    return openvino.Tensor(value.numpy(), shared_memory=True)


def _refusal(path: Path, graph: bytes, error: Exception) -> str:
    if b"DeformConv" in graph and "DeformConv" in str(error):
        return (
            f"{path}: expected the grid-sample form, because OpenVINO has no operator DeformConv; got a graph with it. "
            "Export with --dcn grid-sample, or use --engine onnxruntime."
        )
    return f"{path}: OpenVINO refuses the graph: {_message(error)}"


def _message(error: Exception) -> str:
    """The message of an exception on one line, without the source files of OpenVINO that it names."""
    lines = [line.strip() for line in str(error).splitlines()]
    return printable(" ".join(line for line in lines if line and not line.startswith("Exception from ")))
