"""A new export shows differences that no input happened to exercise."""

import numpy as np
import onnx
import pytest
from onnx import helper, numpy_helper

from duospacenet.export.graphs import graphs_to_export
from duospacenet.export.parity.retraced_graphs import graph_differences, retrace_graphs
from duospacenet.runtime.bundle.manifest import read_manifest
from tests.faults.bench import constant, nodes_of, producer_of, set_attribute, splice
from tests.faults.tensor_edits import set_values
from tests.helpers.bundles import edit_graph
from tests.helpers.exports import share_conversions

WEIGHT = "model.decoder.layers.0.feedforward.0.weight"


@pytest.fixture
def decoder(tiny_bundle):
    return onnx.load(tiny_bundle / "decoder.onnx")


@pytest.fixture
def changed(tiny_bundle):
    """A copy of the decoder that a test may change."""
    return onnx.load(tiny_bundle / "decoder.onnx")


def test_a_new_export_equals_the_bundle_and_finds_a_changed_limit(copied_bundle, tiny_model):
    """The smallest visible depth is 0.105 m instead of 0.1 m. Points between the two are rare."""
    edit_graph(copied_bundle, "projector", lambda model: set_values(model, smallest_depth(model), np.array(0.105)))
    with share_conversions():
        found = retrace_graphs(copied_bundle, read_manifest(copied_bundle), graphs_to_export(tiny_model))
    assert found.graphs == ("projector", "backbone", "lifter", "decoder", "segmenter")
    assert found.skipped is None
    (difference,) = found.differences
    assert difference.startswith("new export, projector: constant ")
    assert difference.endswith("; got 0.105")


def smallest_depth(model):
    return nodes_of(model, "Greater")[0].input[1]


def test_a_bundle_of_other_versions_is_not_compared(tiny_bundle, tiny_model):
    manifest = read_manifest(tiny_bundle)
    other = manifest.model_copy(update={"versions": manifest.versions | {"torch": "2.1.0"}})
    found = retrace_graphs(tiny_bundle, other, graphs_to_export(tiny_model))
    assert found.graphs == found.differences == ()
    assert found.skipped.startswith("the bundle was exported with torch 2.1.0 (installed: ")


def test_equal_graphs_have_no_difference(decoder, changed):
    assert list(graph_differences(changed, decoder)) == []


def test_rounding_of_a_folded_constant_is_no_difference(decoder, changed):
    values = next(numpy_helper.to_array(t) for t in decoder.graph.initializer if t.name == WEIGHT)
    set_values(changed, WEIGHT, values + 5e-7 * np.abs(values).max())
    assert list(graph_differences(changed, decoder)) == []
    set_values(changed, WEIGHT, values + 5e-6 * np.abs(values).max())
    (difference,) = graph_differences(changed, decoder)
    assert difference.startswith(f"constant '{WEIGHT}'[")


def index_3(model):
    """The name of the index 3, with which a Gather reads the translation of a motion and the oldest slot."""
    return nodes_of(model, "Gather")[0].input[1]


def exchange_inputs(model):
    node = producer_of(model, "cat_2")
    node.input[2], node.input[3] = node.input[3], node.input[2]


def rename(model):
    old, new = "layer_norm_2", "other"
    for node in model.graph.node:
        node.output[:] = [new if name == old else name for name in node.output]
        node.input[:] = [new if name == old else name for name in node.input]


@pytest.mark.parametrize(
    ("change", "difference"),
    [
        (exchange_inputs, "operator: expected Concat('add', "),
        (rename, "operator: expected LayerNormalization('{norm_input}', "),
        (lambda m: splice(m, "time_delta_s", "Clip", np.float32([0])[0:1], np.float32([3])), "operator: "),
        (
            lambda m: set_attribute(nodes_of(m, "Softmax")[1], "axis", 2),
            "operator: expected Softmax('{softmax_input}', axis=-1)",
        ),
        (lambda m: nodes_of(m, "Softmax")[0].attribute.extend(list(nodes_of(m, "Softmax")[0].attribute)), "operator: "),
        (lambda m: setattr(nodes_of(m, "Gemm")[0], "domain", "com.example"), "operator: expected Gemm("),
        (lambda m: m.graph.node.append(helper.make_node("Identity", ["boxes"], ["end"])), "number of operators: "),
        (lambda m: constant(m, np.zeros(3), "extra"), "constants: expected []; got ['extra']"),
        (lambda m: m.graph.initializer.append(m.graph.initializer[0]), "number of constants: "),
        (lambda m: set_values(m, index_3(m), np.array(2)), "constant '{index_3}'[]: expected 3; got 2"),
        (lambda m: set_values(m, index_3(m), np.array([3])), "type of constant '{index_3}': "),
        (lambda m: set_values(m, WEIGHT, np.full((64, 64), np.nan)), f"constant '{WEIGHT}'[0, 0]: expected "),
        (lambda m: setattr(m.opset_import[0], "version", 20), "operator sets: expected [('', 19)]; got [('', 20)]"),
        (lambda m: setattr(m.graph.input[0], "name", "other"), "inputs: "),
        (lambda m: m.graph.output.reverse(), "outputs: "),
        (lambda m: m.functions.add(), "functions: expected 0; got 1"),
        (lambda m: m.graph.sparse_initializer.add(), "sparse constants: expected 0; got 1"),
    ],
)
def test_every_change_of_a_graph_is_found(decoder, changed, change, difference):
    change(changed)
    names = {
        "index_3": index_3(decoder),
        "norm_input": producer_of(decoder, "layer_norm_2").input[0],
        "softmax_input": nodes_of(decoder, "Softmax")[1].input[0],
    }
    assert next(graph_differences(changed, decoder)).startswith(difference.format(**names))
