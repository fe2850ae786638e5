"""A graph file cut into pieces at every tensor that eager mode computes too.

Each piece runs on eager mode's values. Errors therefore do not add up from piece to piece, and a wrong result means a
wrong piece.
"""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import onnx
import onnxruntime as ort
from numpy.typing import NDArray
from onnx import NodeProto, ValueInfoProto, helper, numpy_helper

# Prefix of the inputs with eager mode's values. A cut tensor can be the input of one piece and the result of another in
# the same model, so it needs two names.
_EAGER = "eager."


@dataclass(frozen=True)
class Piece:
    """The nodes that compute `tensor` from other cut tensors.

    reads: the cut tensors and graph inputs that the nodes read.
    constants: the names of the initializers that the nodes read.
    """

    tensor: str
    nodes: tuple[NodeProto, ...]
    reads: tuple[str, ...]
    constants: tuple[str, ...]

    @property
    def operators(self) -> tuple[str, ...]:
        """The operator of each node."""
        return tuple(node.op_type for node in self.nodes)


class CutGraph:
    """A graph file that is cut into pieces. `pieces` holds them by the name of their result, in the file's order."""

    def __init__(self, file: onnx.ModelProto, cut_names: Collection[str]) -> None:
        """Cut `file` at the tensors `cut_names`. Names that the file does not compute are ignored."""
        self._file = file
        self._initializers = {tensor.name: tensor for tensor in file.graph.initializer}
        self._inputs = {value.name: value for value in file.graph.input}
        self._producers = {name: index for index, node in enumerate(file.graph.node) for name in node.output if name}
        computed = [name for node in file.graph.node for name in node.output]
        self._cut_names = {name for name in computed if name in cut_names}
        self._types = _element_types(file)
        self.pieces = {name: self._piece(name) for name in computed if name in self._cut_names}

    def constant(self, name: str) -> NDArray | None:
        """The value of an initializer, or None if `name` is not an initializer."""
        return numpy_helper.to_array(self._initializers[name]) if name in self._initializers else None

    def run(self, tensors: Iterable[str], values: Mapping[str, NDArray]) -> dict[str, NDArray]:
        """Compute `tensors`, each with its own piece, without optimisations.

        values: the tensors that the pieces read, by name.
        """
        pieces = [self.pieces[name] for name in tensors]
        session = unoptimised_session(self._assemble(pieces, values).SerializeToString())
        inputs = {name: self._value(name, values) for name in (value.name for value in session.get_inputs())}
        names = [piece.tensor for piece in pieces]
        return dict(zip(names, session.run(names, inputs), strict=True))

    def _piece(self, tensor: str) -> Piece:
        """Collect the nodes of `tensor`, going back to cut tensors, graph inputs and initializers."""
        nodes: set[int] = set()
        reads: dict[str, None] = {}
        constants: dict[str, None] = {}
        pending = [self._producers[tensor]]
        while pending:
            index = pending.pop()
            if index in nodes:
                continue
            nodes.add(index)
            for name in self._file.graph.node[index].input:
                if name in self._initializers:
                    constants[name] = None
                elif name in self._cut_names or name in self._inputs:
                    reads[name] = None
                elif name:
                    pending.append(self._producers[name])
        ordered = tuple(self._file.graph.node[index] for index in sorted(nodes))
        return Piece(tensor, ordered, tuple(reads), tuple(constants))

    def _assemble(self, pieces: list[Piece], values: Mapping[str, NDArray]) -> onnx.ModelProto:
        """One model with all `pieces`. A piece does not read the results of other pieces, but inputs of the model."""
        indices = sorted({self._producers[node.output[0]] for piece in pieces for node in piece.nodes})
        reads = dict.fromkeys(name for piece in pieces for name in piece.reads)
        constants = dict.fromkeys(name for piece in pieces for name in piece.constants)
        return helper.make_model(
            helper.make_graph(
                [self._with_eager_inputs(self._file.graph.node[index]) for index in indices],
                "pieces",
                [self._input_info(name, values[name].shape) for name in reads],
                [helper.make_empty_tensor_value_info(piece.tensor) for piece in pieces],
                [self._initializers[name] for name in constants],
            ),
            # The defaults of onnx 1.23, IR 14 and opset 28, are too new for onnxruntime 1.31.
            ir_version=self._file.ir_version,
            opset_imports=self._file.opset_import,
        )

    def _with_eager_inputs(self, node: NodeProto) -> NodeProto:
        renamed = NodeProto()
        renamed.CopyFrom(node)
        renamed.input[:] = [self._input_name(name) for name in node.input]
        return renamed

    def _input_info(self, name: str, shape: tuple[int, ...]) -> ValueInfoProto:
        return helper.make_tensor_value_info(self._input_name(name), self._types[name], shape)

    def _input_name(self, name: str) -> str:
        return _EAGER + name if name in self._cut_names else name

    def _value(self, input_name: str, values: Mapping[str, NDArray]) -> NDArray:
        """The value of an input, in the file's type. Eager mode may use another type, for example for indices."""
        name = input_name.removeprefix(_EAGER)
        return values[name].astype(helper.tensor_dtype_to_np_dtype(self._types[name]), copy=False)


def unoptimised_session(model: bytes | Path) -> ort.InferenceSession:
    """A session without graph optimisations, on the thread pool that all pipelines of the process share."""
    options = ort.SessionOptions()
    options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_DISABLE_ALL
    options.use_per_session_threads = False
    options.log_severity_level = 3
    return ort.InferenceSession(model, options, providers=["CPUExecutionProvider"])


def _element_types(file: onnx.ModelProto) -> dict[str, int]:
    """The element type of every tensor of the file, by name."""
    graph = onnx.shape_inference.infer_shapes(file).graph
    return {value.name: value.type.tensor_type.elem_type for value in (*graph.input, *graph.value_info, *graph.output)}
