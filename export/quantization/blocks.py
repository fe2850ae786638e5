"""The blocks of a graph: the parts of the model that are quantized, or left in float32, as a whole.

A block is named after a module of the model, for example `image_encoder.backbone.layer1`. The names come from the
weights in the graph, so a block does not depend on the numbers of the tracer's nodes.
"""

from collections.abc import Iterator, Mapping, Sequence

import onnx
from onnx import NodeProto

from ...runtime.bundle.manifest import GraphName

CONVOLUTIONAL = ("Conv", "Add", "MaxPool", "Relu")  # Concat was slower with int8 than without

# The operators that are quantized, by graph. The projector and the decoder compute positions, which 8 bits would round
# by decimetres. The decoder's matrix products can be added as "decoder": ("Gemm", "Relu").
OPERATORS: Mapping[GraphName, tuple[str, ...]] = {
    "backbone": CONVOLUTIONAL,
    "lifter": CONVOLUTIONAL,
    "segmenter": CONVOLUTIONAL,
}
WEIGHTED = ("Conv", "Gemm")  # operators with a weight, which decides their block

# These stay in float32. Rounded positions and weights of samples move features, and rounded logits move scores.
FLOAT_MODULES = ("conv_offset", "sampling_offsets", "attention_weights", "segmentation.heads", ".heads.")

_PREFIX = "model."  # a graph's module is a wrapper that holds the model as its attribute `model`
# The number of components of a block's name, by the first components of the module's name.
_DEPTHS = {"image_encoder.backbone": 3, "decoder": 4}
_DEFAULT_DEPTH = 2
# Operators through which an Add may get the result of a quantized operator.
_PASSED_THROUGH = ("Resize",)


def blocks_of(graph: onnx.GraphProto, operators: Sequence[str] = CONVOLUTIONAL) -> dict[str, list[str]]:
    """The names of the nodes that can be quantized, by block, in the order of the graph.

    operators: those that may be quantized.

    A Conv or Gemm belongs to the block of its weight. An Add, MaxPool or Relu belongs to the block of the last operator
    before it. They are left out if one of their inputs is not the result of such an operator: it would have to be
    quantized for them alone.
    """
    blocks: dict[str, list[str]] = {}
    block_of_tensor: dict[str, str] = {}
    order: dict[str, int] = {}
    weights = {tensor.name for tensor in graph.initializer}
    for index, node in enumerate(graph.node):
        block = _block_of_node(node, operators, block_of_tensor, order, weights)
        if block is None:
            continue
        block_of_tensor[node.output[0]], order[node.output[0]] = block, index
        if node.op_type in operators:
            blocks.setdefault(block, []).append(node.name)
    return {block: nodes for block, nodes in blocks.items() if _has_weight(graph, nodes)}


def block_name(module: str) -> str:
    """The block of a module, for example `image_encoder.neck` for `image_encoder.neck.lateral.0`.

    Numbers of layers do not count: `decoder.layers.0.cross_attention.pv.attention` gives
    `decoder.layers.cross_attention.pv`.
    """
    parts = [part for part in module.split(".") if not part.isdigit()]
    depth = next((depth for prefix, depth in _DEPTHS.items() if module.startswith(prefix)), _DEFAULT_DEPTH)
    return ".".join(parts[:depth])


def _block_of_node(
    node: NodeProto, operators: Sequence[str], block_of_tensor: dict[str, str], order: dict[str, int], weights: set[str]
) -> str | None:
    """The block of a node, or None if it cannot be quantized."""
    if node.op_type in WEIGHTED:
        return _block_of_weight(node.input[1]) if node.op_type in operators and node.input[1] in weights else None
    inputs = list(node.input[:1]) if node.op_type in (*_PASSED_THROUGH, "MaxPool", "Relu") else list(node.input)
    if node.op_type not in (*operators, *_PASSED_THROUGH) or not all(name in block_of_tensor for name in inputs):
        return None
    return block_of_tensor[max(inputs, key=lambda name: order[name])]


def _block_of_weight(name: str) -> str | None:
    if not name.startswith(_PREFIX) or any(part in name for part in FLOAT_MODULES):
        return None
    return block_name(name.removeprefix(_PREFIX).rpartition(".")[0])


def _has_weight(graph: onnx.GraphProto, nodes: Sequence[str]) -> bool:
    names = set(nodes)
    return any(node.op_type in WEIGHTED for node in _nodes_named(graph, names))


def _nodes_named(graph: onnx.GraphProto, names: set[str]) -> Iterator[NodeProto]:
    return (node for node in graph.node if node.name in names)
