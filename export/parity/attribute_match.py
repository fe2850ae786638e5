"""The attributes of a graph's operators, compared with the modules of the model."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import onnx
from onnx import NodeProto, defs, helper
from torch import nn

from ...model.backbones.deformable_convolution import DeformableConvolution
from .graph_constants import all_nodes, opset_of


@dataclass(frozen=True)
class AttributeDifference:
    """An attribute of an operator that differs from the model.

    graph: the name of the graph. node: the name of the operator's first output.
    value: the attribute in the graph. expected: the attribute that the model gives.
    """

    graph: str
    node: str
    operator: str
    attribute: str
    value: str
    expected: str

    def __str__(self) -> str:
        place = f"{self.graph}.{self.node}"
        return f"{place}: expected {self.operator} with {self.attribute} {self.expected}; got {self.value}"


def attribute_differences(
    graph: str, stored: onnx.ModelProto, tensor_of: Mapping[str, str], model: nn.Module
) -> Iterator[AttributeDifference]:
    """The attributes of the operators in `stored` that differ from the modules of `model`.

    Compared are the operators with a weight of the model, and those that the model uses with the same attributes
    everywhere.

    tensor_of: the tensor of the model that each constant of the graph holds.
    """
    opset = opset_of(stored)
    for node in all_nodes(stored.graph):
        # The second input is the weight of every operator that has one.
        weight = tensor_of.get(node.input[1]) if len(node.input) > 1 else None
        module = model.get_submodule(weight.rpartition(".")[0]) if weight else None
        for attribute, expected in _expected(node, module, opset).items():
            value = _value(node, attribute, expected, opset)
            if value != expected:
                yield AttributeDifference(graph, node.output[0], node.op_type, attribute, str(value), str(expected))


def _expected(node: NodeProto, module: nn.Module | None, opset: int) -> dict[str, Any]:
    """The attributes that `node` must have.

    module: the module of the model whose weight the node reads, if it reads one.
    """
    if node.op_type == "GridSample":
        # The mode has two names: GridSample-20 samples volumes too.
        return {"mode": "linear" if opset >= 20 else "bilinear", "padding_mode": "zeros", "align_corners": 0}
    if node.op_type == "Softmax":
        return {"axis": -1}
    if node.op_type == "Gemm":
        return {"alpha": 1.0, "beta": 1.0, "transA": 0, "transB": 1}
    if node.op_type == "LayerNormalization" and isinstance(module, nn.LayerNorm):
        return {"epsilon": module.eps, "axis": -1, "stash_type": 1}
    if node.op_type == "BatchNormalization" and isinstance(module, (nn.BatchNorm2d, nn.BatchNorm3d)):
        return {"epsilon": module.eps, "training_mode": 0}
    if node.op_type == "Conv" and isinstance(module, (nn.Conv2d, nn.Conv3d)):
        return _expected_of_convolution(module)
    if node.op_type == "DeformConv" and isinstance(module, DeformableConvolution):
        return {"strides": [module.stride] * 2, "pads": [1] * 4, "dilations": [1, 1], "group": 1, "offset_group": 1}
    return {}


def _expected_of_convolution(module: nn.Conv2d | nn.Conv3d) -> dict[str, Any]:
    return {
        "strides": list(module.stride),
        "pads": [*module.padding, *module.padding],
        "dilations": list(module.dilation),
        "group": module.groups,
        "auto_pad": "NOTSET",
    }


def _value(node: NodeProto, name: str, expected: Any, opset: int) -> Any:
    """The attribute `name` of `node`, or its default in this operator set, as the type of `expected`."""
    values = [helper.get_attribute_value(attribute) for attribute in node.attribute if attribute.name == name]
    if isinstance(expected, list):
        # The default of strides and dilations is 1 everywhere, that of pads 0.
        return list(values[0]) if values else [0 if name == "pads" else 1] * len(expected)
    default = defs.get_schema(node.op_type, opset).attributes[name].default_value
    value = values[0] if values else helper.get_attribute_value(default)
    if isinstance(value, bytes):
        return value.decode(errors="replace")
    # A file holds float32.
    return expected if isinstance(expected, float) and np.float32(value) == np.float32(expected) else value
