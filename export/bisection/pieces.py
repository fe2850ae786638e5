"""A graph file cut at every tensor that eager mode knows too, so that each piece can run on eager's own values.

Errors then do not add up on the way: a piece that is off is off by itself.
"""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import onnx
import onnxruntime as ort
from numpy.typing import NDArray
from onnx import NodeProto, ValueInfoProto, helper, numpy_helper

_EAGER = "eager."  # before the name of a tensor that is fed, to tell it from the one that is computed


@dataclass(frozen=True)
class Piece:
    """The nodes that make `tensor` of other known tensors.

    reads: the known tensors and graph inputs among what the nodes take; constants: the tensors in the file.
    """

    tensor: str
    nodes: tuple[NodeProto, ...]
    reads: tuple[str, ...]
    constants: tuple[str, ...]

    @property
    def operators(self) -> tuple[str, ...]:
        return tuple(node.op_type for node in self.nodes)


class CutGraph:
    """A graph file in pieces, by the tensor they end in, in the file's order."""

    def __init__(self, file: onnx.ModelProto, known: Collection[str]) -> None:
        """known: names of tensors to cut at. Names that the file does not compute are passed over."""
        self._file = file
        self._initializers = {tensor.name: tensor for tensor in file.graph.initializer}
        self._inputs = {value.name: value for value in file.graph.input}
        self._makers = {name: index for index, node in enumerate(file.graph.node) for name in node.output if name}
        computed = [name for node in file.graph.node for name in node.output]
        self._known = {name for name in computed if name in known}
        self._types = _element_types(file)
        self.pieces = {name: self._piece(name) for name in computed if name in self._known}

    def constant(self, name: str) -> NDArray | None:
        """A tensor that lies in the file, or None for one that does not."""
        return numpy_helper.to_array(self._initializers[name]) if name in self._initializers else None

    def is_named(self, name: str) -> bool:
        """Whether a tensor has a name that means something outside of this file: cut at, or an input."""
        return name in self._known or name in self._inputs

    def run(self, tensors: Iterable[str], values: Mapping[str, NDArray]) -> dict[str, NDArray]:
        """Compute `tensors`, each by its own piece; `values` holds what the pieces read. Nothing is optimised."""
        pieces = [self.pieces[name] for name in tensors]
        session = plain_session(self._assemble(pieces, values).SerializeToString())
        feed = {name: self._value(name, values) for name in (put.name for put in session.get_inputs())}
        names = [piece.tensor for piece in pieces]
        return dict(zip(names, session.run(names, feed), strict=True))

    def _piece(self, tensor: str) -> Piece:
        """Walk back from `tensor` to what is known, given or constant."""
        nodes: set[int] = set()
        reads: dict[str, None] = {}
        constants: dict[str, None] = {}
        waiting = [self._makers[tensor]]
        while waiting:
            index = waiting.pop()
            if index in nodes:
                continue
            nodes.add(index)
            for name in self._file.graph.node[index].input:
                if name in self._initializers:
                    constants[name] = None
                elif self.is_named(name):
                    reads[name] = None
                elif name:
                    waiting.append(self._makers[name])
        ordered = tuple(self._file.graph.node[index] for index in sorted(nodes))
        return Piece(tensor, ordered, tuple(reads), tuple(constants))

    def _assemble(self, pieces: list[Piece], values: Mapping[str, NDArray]) -> onnx.ModelProto:
        """One model of pieces that do not touch: each reads what is fed, and none what another has made."""
        indices = sorted({self._makers[node.output[0]] for piece in pieces for node in piece.nodes})
        reads = dict.fromkeys(name for piece in pieces for name in piece.reads)
        constants = dict.fromkeys(name for piece in pieces for name in piece.constants)
        return helper.make_model(
            helper.make_graph(
                [self._fed(self._file.graph.node[index]) for index in indices],
                "pieces",
                [self._fed_input(name, values[name].shape) for name in reads],
                [helper.make_empty_tensor_value_info(piece.tensor) for piece in pieces],
                [self._initializers[name] for name in constants],
            ),
            ir_version=self._file.ir_version,
            opset_imports=self._file.opset_import,
        )

    def _fed(self, node: NodeProto) -> NodeProto:
        fed = NodeProto()
        fed.CopyFrom(node)
        fed.input[:] = [self._fed_name(name) for name in node.input]
        return fed

    def _fed_input(self, name: str, shape: tuple[int, ...]) -> ValueInfoProto:
        return helper.make_tensor_value_info(self._fed_name(name), self._types[name], shape)

    def _fed_name(self, name: str) -> str:
        return _EAGER + name if name in self._known else name

    def _value(self, fed_name: str, values: Mapping[str, NDArray]) -> NDArray:
        """What is fed, in the type that the file computes in, should eager mode have another."""
        name = fed_name.removeprefix(_EAGER)
        return values[name].astype(helper.tensor_dtype_to_np_dtype(self._types[name]), copy=False)


def plain_session(model: bytes | Path) -> ort.InferenceSession:
    """A session in which nothing is optimised, on the pool that the process's pipelines share."""
    options = ort.SessionOptions()
    options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_DISABLE_ALL
    options.use_per_session_threads = False
    options.log_severity_level = 3
    return ort.InferenceSession(model, options, providers=["CPUExecutionProvider"])


def _element_types(file: onnx.ModelProto) -> dict[str, int]:
    graph = onnx.shape_inference.infer_shapes(file).graph
    return {value.name: value.type.tensor_type.elem_type for value in (*graph.input, *graph.value_info, *graph.output)}
