"""The dequantized form of a quantized graph: the same operators in float32, with the rounded weights.

The parity check compares this form with the model like a float32 graph, except that every weight may differ by half a
step of its scale. What is left, the rounding of the activations, is checked by `activation_scales`.

1. A DequantizeLinear of a constant becomes a constant in float32.
2. A pair of QuantizeLinear and DequantizeLinear is removed.
3. If its zero point is 0, it clips at 0: it does the work of a Relu, which the quantizer removed. The Relu comes back
   with `with_relu`.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import NodeProto, helper, numpy_helper

from ..quantization.blocks import WEIGHTED

_CONSTANT_SUFFIX = "_quantized"  # of the quantizer's name for the integers of a weight
_PRODUCER_SUFFIX = "_QuantizeLinear_Input"  # of its name for an output of the graph before it is rounded
COPY_MARK = "#"  # before the number of a copied bias
_CLIPPED_OPERATORS = ("Conv", "Gemm", "Add")  # before a Relu that the quantizer may remove


class ActivationScale(NamedTuple):
    """The rounding of a tensor: to (q - zero_point) * scale with q from 0 to 255."""

    tensor: str
    scale: float
    zero_point: int

    @property
    def range(self) -> tuple[float, float]:
        """The smallest and the largest number that can be represented."""
        return -self.zero_point * self.scale, (255 - self.zero_point) * self.scale


@dataclass(frozen=True)
class DequantizedGraph:
    """The dequantized form of a quantized graph.

    model: the form, as a model.
    half_steps: half a step of each number of a dequantized constant, by the constant's name.
    activations: the rounding of each tensor, by its name.
    clipped: tensors that the rounding clips at 0, behind an operator without a Relu.
    failures: contradictions between the scales of the graph, one line each.
    """

    model: onnx.ModelProto
    half_steps: Mapping[str, NDArray[np.float64]]
    activations: Mapping[str, ActivationScale]
    clipped: frozenset[str]
    failures: tuple[str, ...]


def is_quantized(graph: onnx.GraphProto) -> bool:
    """Whether the graph has an operator that rounds."""
    return any(node.op_type in ("QuantizeLinear", "DequantizeLinear") for node in graph.node)


def dequantize(model: onnx.ModelProto, with_relu: bool = True) -> DequantizedGraph:
    """Compute the dequantized form of a model.

    with_relu: put a Relu where the rounding clips at 0 behind a Conv or an Add. Without it, the form has exactly the
        operators of the file.
    """
    return _Dequantizer(model).run(with_relu)


class _Dequantizer:
    def __init__(self, model: onnx.ModelProto) -> None:
        self._model = model
        self._constants = {tensor.name: numpy_helper.to_array(tensor) for tensor in model.graph.initializer}
        self._producers = {name: node for node in model.graph.node for name in node.output}
        self._names: dict[str, str] = {}  # new names of tensors
        self._dequantized: dict[str, NDArray[np.float64]] = {}
        self._half_steps: dict[str, NDArray[np.float64]] = {}
        self._scales: dict[str, float | NDArray] = {}  # of dequantized constants and activations, by new name
        self._activations: dict[str, ActivationScale] = {}
        self._failures: list[str] = []

    def run(self, with_relu: bool) -> DequantizedGraph:
        nodes = list(self._model.graph.node)
        removed = [node for node in nodes if node.op_type == "DequantizeLinear" and self._remove(node)]
        removed += self._unread_quantizers(removed)
        kept = [self._renamed(node) for node in nodes if node not in removed]
        self._compare_bias_scales(kept)
        clipped = frozenset(
            node.output[0]
            for node in kept
            if node.op_type in _CLIPPED_OPERATORS
            and (scale := self._activations.get(node.output[0]))
            and scale.zero_point == 0
        )
        if with_relu:
            kept = [each for node in kept for each in _with_relu(node, clipped)]
        return DequantizedGraph(
            self._to_model(kept), self._half_steps, self._activations, clipped, tuple(self._failures)
        )

    def _remove(self, node: NodeProto) -> bool:
        """Replace a DequantizeLinear by a constant, or by the tensor before its QuantizeLinear.

        Returns whether the node is not needed any more.
        """
        if node.input[0] in self._constants:
            self._dequantize_constant(node)
            return True
        quantizer = self._producers.get(node.input[0])
        if quantizer is None or quantizer.op_type != "QuantizeLinear":
            self._failures.append(f"{node.output[0]}: expected QuantizeLinear before DequantizeLinear; got none")
            return False
        tensor = quantizer.input[0].removesuffix(_PRODUCER_SUFFIX)
        scale, zero_point = self._parameters(node)
        if (scale.size, zero_point.size) != (1, 1) or zero_point.dtype != np.uint8:
            self._failures.append(f"{tensor}: expected one scale and one uint8 zero point; got others")
        elif any(
            not np.array_equal(a, b) for a, b in zip(self._parameters(quantizer), (scale, zero_point), strict=True)
        ):
            self._failures.append(f"{tensor}: QuantizeLinear and DequantizeLinear have different scales")
        elif not (np.isfinite(scale).all() and scale.item() > 0):
            self._failures.append(f"{tensor}: expected a scale above 0; got {scale.item():g}")
        activation = ActivationScale(tensor, float(scale.flat[0]), int(zero_point.flat[0]))
        if self._activations.setdefault(tensor, activation) != activation:
            self._failures.append(f"{tensor}: expected one rounding; got two with different scales")
        self._scales[tensor] = activation.scale
        self._names[quantizer.input[0]] = self._names[node.output[0]] = tensor
        return True

    def _unread_quantizers(self, removed: list[NodeProto]) -> list[NodeProto]:
        """The QuantizeLinear nodes whose results only removed nodes read. A result with another reader is a failure."""
        nodes = self._model.graph.node
        readers = [node for node in nodes if node not in removed]
        still_read = {name for node in readers for name in node.input} | {
            each.name for each in self._model.graph.output
        }
        quantizers = [node for node in nodes if node.op_type == "QuantizeLinear"]
        for node in quantizers:
            if node.output[0] in still_read:
                self._failures.append(f"{node.output[0]}: expected DequantizeLinear behind QuantizeLinear; got others")
        return [node for node in quantizers if node.output[0] not in still_read]

    def _dequantize_constant(self, node: NodeProto) -> None:
        integers, (scale, zero_point) = self._constants[node.input[0]], self._parameters(node)
        name = self._constant_name(node.input[0].removesuffix(_CONSTANT_SUFFIX))
        axis = next((attribute.i for attribute in node.attribute if attribute.name == "axis"), 1)
        shape = [-1 if scale.size > 1 and index == axis % integers.ndim else 1 for index in range(integers.ndim)]
        steps = np.broadcast_to(scale.astype(np.float64).reshape(shape), integers.shape)
        if zero_point.any() or not (np.isfinite(scale).all() and (scale > 0).all()):
            self._failures.append(f"{name}: expected scales above 0 and zero points of 0; got others")
        self._dequantized[name], self._half_steps[name] = integers.astype(np.float64) * steps, steps / 2
        self._scales[name], self._names[node.output[0]] = scale.astype(np.float64).ravel(), name

    def _constant_name(self, name: str) -> str:
        """The name of a constant in the float32 graph.

        A bias with several users is copied, because its scale depends on the input. The copies end with a number.
        """
        base = name.rstrip("0123456789")
        return (
            name
            if base == name or f"{base}{_CONSTANT_SUFFIX}" not in self._constants
            else f"{base}{COPY_MARK}{name[len(base) :]}"
        )

    def _parameters(self, node: NodeProto) -> tuple[NDArray, NDArray]:
        """The scale and the zero point of a QuantizeLinear or DequantizeLinear."""
        nothing = np.array(np.nan, np.float32), np.array(0, np.uint8)
        names = [*node.input[1:], "", ""][:2]
        scale, zero_point = (self._constants.get(name, default) for name, default in zip(names, nothing, strict=True))
        return np.asarray(scale), np.asarray(zero_point)

    def _compare_bias_scales(self, nodes: list[NodeProto]) -> None:
        """The scale of a bias must be the product of those of the input and of the weight: the engine adds integers."""
        for node in nodes:
            if node.op_type not in WEIGHTED or len(node.input) < 3 or node.input[2] not in self._half_steps:
                continue
            source, weight, bias = (self._scales.get(name) for name in node.input[:3])
            if source is None or weight is None or bias is None:
                self._failures.append(f"{node.output[0]}: expected a quantized input and weight with a quantized bias")
            elif not np.allclose(bias, np.multiply(source, weight), rtol=1e-5, atol=0):
                self._failures.append(
                    f"{node.output[0]}: expected the scale of {node.input[0]} times that of the weight as the scale of "
                    "the bias; got another one"
                )

    def _renamed(self, node: NodeProto) -> NodeProto:
        renamed = NodeProto()
        renamed.CopyFrom(node)
        renamed.input[:] = map(self._name, node.input)
        renamed.output[:] = map(self._name, node.output)
        return renamed

    def _name(self, name: str) -> str:
        """The new name of a tensor. A tensor that is rounded twice has two new names, one after the other."""
        while self._names.get(name, name) != name:
            name = self._names[name]
        return name

    def _to_model(self, nodes: list[NodeProto]) -> onnx.ModelProto:
        used = {name for node in nodes for name in node.input}
        constants = {name: value for name, value in self._constants.items() if name in used}
        constants |= {name: value.astype(np.float32) for name, value in self._dequantized.items()}
        graph = helper.make_graph(
            nodes,
            self._model.graph.name,
            self._model.graph.input,
            self._model.graph.output,
            [numpy_helper.from_array(value, name) for name, value in constants.items()],
        )
        return helper.make_model(graph, ir_version=self._model.ir_version, opset_imports=self._model.opset_import)


def _with_relu(node: NodeProto, clipped: frozenset[str]) -> list[NodeProto]:
    """The node, and a Relu behind it if its output is clipped."""
    tensor = node.output[0]
    if tensor not in clipped:
        return [node]
    unclipped = NodeProto()
    unclipped.CopyFrom(node)
    unclipped.output[0] = f"{tensor}_unclipped"
    return [unclipped, helper.make_node("Relu", [unclipped.output[0]], [tensor])]
