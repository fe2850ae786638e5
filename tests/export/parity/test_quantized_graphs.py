"""The parity of int8 bundles: an undamaged one passes, and each kind of damage is named."""

import shutil

import numpy as np
import onnx
import pytest

from duospacenet.export import check_parity
from duospacenet.export.parity import retraced_graphs
from duospacenet.export.parity.quantized_graphs import QuantizedGraphs
from duospacenet.export.parity.stress_sequence import stress_sequence
from duospacenet.model import PRESETS
from duospacenet.runtime import Pipeline
from duospacenet.runtime.bundle.manifest import read_manifest
from tests.helpers.bundles import edit_graph, edit_manifest
from tests.helpers.quantized import nodes_of_type, numbers, set_constant

THREE_FRAMES = stress_sequence(PRESETS["tiny"])[:3]
OTHER_BLOCK = "image_encoder.backbone.layer9"


@pytest.fixture
def int8_bundle(tiny_int8_bundle, tmp_path):
    """A copy of the int8 bundle that a test may change."""
    return shutil.copytree(tiny_int8_bundle, tmp_path / "int8")


@pytest.fixture
def reuse_new_export(tiny_bundle, monkeypatch):
    """The new export is a copy of `tiny_bundle`, which saves time."""
    monkeypatch.setattr(retraced_graphs, "trace", lambda graph, path, forms: shutil.copy(tiny_bundle / path.name, path))


def failures(bundle, model, **options) -> list[str]:
    result = check_parity(bundle, model, stress_frames=THREE_FRAMES, random_inputs=1, **options)
    assert result.precision == "int8"
    return [line for line in result.failures if not line.startswith("coverage")]


def read(bundle) -> QuantizedGraphs:
    return QuantizedGraphs.read(bundle, read_manifest(bundle))


def change_a_weight(model: onnx.ModelProto) -> None:
    """Set one number of the last quantized weight to another integer."""
    name = [each.name for each in model.graph.initializer if each.name.endswith(".weight_quantized")][-1]
    values = numbers(model, name)
    values.flat[5] += 40 if values.flat[5] < 0 else -40
    set_constant(model, name, values)


def change_a_scale(model: onnx.ModelProto) -> None:
    """Multiply the scale of the first activation by 1.5."""
    name = nodes_of_type(model, "QuantizeLinear")[0].input[1]
    set_constant(model, name, 1.5 * numbers(model, name))


def exchange_features(model: onnx.ModelProto) -> None:
    """Exchange the weights of two attention values of the same level."""
    nodes = nodes_of_type(model, "Conv")
    first, second = (
        next(node for node in nodes if node.input[1].startswith(f"model.decoder.layers.{layer}.")) for layer in (0, 1)
    )
    first.input[1], second.input[1] = second.input[1], first.input[1]


def test_an_int8_bundle_equals_its_model_within_the_tolerances(tiny_int8_bundle, tiny_model, reuse_new_export):
    result = check_parity(tiny_int8_bundle, tiny_model, retrace=True)
    assert result.passed, result.failures
    assert result.weights.matched == result.weights.parameters > 200
    assert result.retrace.graphs == ("projector", "backbone", "lifter", "decoder", "segmenter")
    report = result.to_report()
    assert report.reference is None and report.tolerances.quantized is not None
    for name, outputs in report.graphs.items():
        assert {error.quantized for error in outputs.values()} == {name in ("backbone", "lifter", "segmenter")}


def test_damage_of_each_kind_is_named(int8_bundle, tiny_model):
    edit_graph(int8_bundle, "segmenter", change_a_weight)
    edit_graph(int8_bundle, "lifter", change_a_scale)
    edit_graph(int8_bundle, "backbone", exchange_features)
    lines = failures(int8_bundle, tiny_model)
    assert any(line.startswith("segmenter.model.segmentation.") and "got 1 other numbers" in line for line in lines)
    assert any(line.startswith("lifter.") and "as the scale of the bias" in line for line in lines)
    assert any(line.startswith("backbone.pv_value_0_") and "RMS error" in line for line in lines)


def test_a_new_export_finds_exchanged_features(int8_bundle, tiny_model, reuse_new_export):
    edit_graph(int8_bundle, "backbone", exchange_features)
    lines = failures(int8_bundle, tiny_model, retrace=True)
    assert any(line.startswith("new export, backbone: operator: expected Conv") for line in lines)


def test_a_frozen_input_is_named(int8_bundle, tiny_model):
    edit_graph(int8_bundle, "lifter", freeze_second_input)
    assert any(
        line.startswith("lifter.") and "disturbed by itself" in line for line in failures(int8_bundle, tiny_model)
    )


def freeze_second_input(model: onnx.ModelProto) -> None:
    """The graph computes with zeros in place of its second input."""
    value = model.graph.input[1]
    shape = [dim.dim_value for dim in value.type.tensor_type.shape.dim]
    model.graph.initializer.append(onnx.numpy_helper.from_array(np.zeros(shape, np.float32), "frozen"))
    for node in model.graph.node:
        node.input[:] = ["frozen" if name == value.name else name for name in node.input]


def test_the_recorded_blocks_must_be_those_of_the_graphs(int8_bundle):
    def record_another_block(manifest):
        manifest["quantization"]["quantized_blocks"][0] = OTHER_BLOCK

    assert read(int8_bundle).failures(read_manifest(int8_bundle)) == []
    edit_manifest(int8_bundle, record_another_block)
    (line,) = read(int8_bundle).failures(read_manifest(int8_bundle))
    assert "field quantization.quantized_blocks" in line and OTHER_BLOCK in line


def test_the_precision_is_that_of_the_graphs(int8_bundle, tiny_bundle):
    assert read(int8_bundle).precision == "int8"
    assert read(tiny_bundle).precision == "float32"


def test_a_float32_bundle_that_calls_itself_int8_is_named(tiny_bundle, tiny_int8_bundle, tmp_path, tiny_model):
    bundle = shutil.copytree(tiny_bundle, tmp_path / "bundle")
    record = read_manifest(tiny_int8_bundle).quantization.model_dump(mode="json")
    edit_manifest(bundle, lambda manifest: manifest.update(precision="int8", quantization=record))
    assert Pipeline.load(bundle).manifest.precision == "int8"
    result = check_parity(bundle, tiny_model, stress_frames=THREE_FRAMES, random_inputs=1)
    assert "manifest.json: field precision: expected 'float32'; got 'int8'" in result.failures
