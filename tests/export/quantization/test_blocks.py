"""Blocks: named after the model's modules, whatever the tracer's numbers are."""

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from duospacenet.export.quantization.blocks import block_name, blocks_of
from tests.helpers.small_graphs import small_model, small_weights

WEIGHT = numpy_helper.from_array(np.zeros((1, 1, 1, 1), np.float32))


def graph_of(*nodes: tuple[str, list[str], str]) -> onnx.GraphProto:
    """A graph from operators, inputs and an output. An input `w:MODULE` is the weight of a module."""
    weights = {name for _, inputs, _ in nodes for name in inputs if name.startswith("w:")}
    return helper.make_graph(
        [
            helper.make_node(operator, [name.replace("w:", "model.") for name in inputs], [output], name=f"n_{output}")
            for operator, inputs, output in nodes
        ],
        "g",
        [helper.make_tensor_value_info("x", TensorProto.FLOAT, [1, 1, 4, 4])],
        [],
        [numpy_helper.from_array(numpy_helper.to_array(WEIGHT), name.replace("w:", "model.")) for name in weights],
    )


@pytest.mark.parametrize(
    ("module", "block"),
    [
        ("image_encoder.backbone.conv1", "image_encoder.backbone.conv1"),
        ("image_encoder.backbone.layer3.1.downsample.0", "image_encoder.backbone.layer3"),
        ("image_encoder.backbone.stage4.2.layers.0", "image_encoder.backbone.stage4"),
        ("image_encoder.neck.lateral.0", "image_encoder.neck"),
        ("divergence_enhancement.conv3d.2.0", "divergence_enhancement.conv3d"),
        ("decoder.layers.1.cross_attention.pv.attention.deformable.value", "decoder.layers.cross_attention.pv"),
        ("segmentation.up.0.3", "segmentation.up"),
    ],
)
def test_a_block_is_named_after_a_part_of_the_model(module, block):
    assert block_name(module) == block


def test_every_convolution_of_tiny_outside_the_heads_is_in_one_block(tiny_bundle):
    for name in ("backbone", "lifter", "segmenter"):
        graph = onnx.load(tiny_bundle / f"{name}.onnx").graph
        in_blocks = [node for nodes in blocks_of(graph).values() for node in nodes]
        assert len(in_blocks) == len(set(in_blocks))
        convolutions = {node.name for node in graph.node if node.op_type == "Conv"}
        heads = {node.name for node in graph.node if node.op_type == "Conv" and "segmentation.heads" in node.input[1]}
        assert convolutions - heads == convolutions & set(in_blocks)


def test_a_relu_belongs_to_the_convolution_before_it():
    blocks = blocks_of(small_model(small_weights()).graph)
    assert blocks == {
        "image_encoder.backbone.layer1": ["node_conv", "node_relu"],
        "image_encoder.neck": ["node_conv_1"],
    }


def test_an_addition_belongs_to_the_last_convolution_before_it():
    graph = graph_of(
        ("Conv", ["x", "w:image_encoder.backbone.layer1.0.conv1.weight"], "a"),
        ("Relu", ["a"], "b"),
        ("Conv", ["b", "w:image_encoder.backbone.layer2.0.conv1.weight"], "c"),
        ("Add", ["c", "b"], "d"),
    )
    assert blocks_of(graph)["image_encoder.backbone.layer2"] == ["n_c", "n_d"]


def test_an_addition_of_a_tensor_that_is_not_quantized_is_left_out():
    graph = graph_of(
        ("Conv", ["x", "w:lifter.reduction.weight"], "a"),
        ("Mul", ["a", "a"], "b"),
        ("Add", ["a", "b"], "c"),
        ("MaxPool", ["b"], "d"),
    )
    assert blocks_of(graph) == {"lifter.reduction": ["n_a"]}


@pytest.mark.parametrize(
    "module", ["image_encoder.backbone.layer3.0.conv2.conv_offset", "segmentation.heads.drivable_area.3"]
)
def test_offsets_and_heads_are_not_quantized(module):
    assert blocks_of(graph_of(("Conv", ["x", f"w:{module}.weight"], "a"), ("Relu", ["a"], "b"))) == {}


def test_a_convolution_with_a_computed_weight_is_not_quantized():
    graph = graph_of(("Mul", ["x", "x"], "weight"), ("Conv", ["x", "weight"], "a"))
    assert blocks_of(graph) == {}


def test_the_matrix_products_of_a_graph_are_blocks_if_its_operators_include_them():
    graph = graph_of(
        ("Gemm", ["x", "w:decoder.layers.0.feedforward.0.weight"], "a"),
        ("Relu", ["a"], "b"),
        ("Gemm", ["b", "w:decoder.layers.0.heads.classes.0.weight"], "c"),
    )
    assert blocks_of(graph) == {}
    assert blocks_of(graph, ("Gemm", "Relu")) == {"decoder.layers.feedforward": ["n_a", "n_b"]}
