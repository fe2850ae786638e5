"""Every version of ONNX's operator set that bundles may have: the same graphs, the same results, the same forms."""

import itertools
import json
from dataclasses import replace
from pathlib import Path
from unittest import mock

import numpy as np
import onnx
import onnx_ir
import openvino
import pytest
import torch
from onnx import helper
from onnxscript import version_converter

from duospacenet import jobs
from duospacenet.cli.main import run_app
from duospacenet.export import export_bundle
from duospacenet.export.operator_forms import OperatorForms
from duospacenet.export.parity.attribute_match import attribute_differences
from duospacenet.export.stateless import INPUTS, StatelessModel, stateless_graph
from duospacenet.export.tracing import trace
from duospacenet.jobs.benchmarking.targets import Target
from duospacenet.jobs.benchmarking.worker import Worker
from duospacenet.model import PRESETS, DuoSpaceNet, randomise
from duospacenet.model.config import ResNetConfig
from duospacenet.runtime.bundle.manifest import read_manifest
from duospacenet.runtime.bundle.operators import DEFAULT_OPSET, OPERATORS, OPSETS
from duospacenet.runtime.errors import UsageError
from tests.helpers.bundles import check_file, edit_graph, edit_manifest
from tests.helpers.exports import session_on_pool, share_conversions
from tests.helpers.model_inputs import assert_close, random_images, random_window

# One graph of the whole model holds every operator of a bundle, in each form.
CONFIG = replace(
    PRESETS["tiny"],
    preset="tiny-dcn",
    backbone=ResNetConfig("bottleneck", (1, 1, 1, 1), width=8, deformable_stages=(3, 4)),
    num_layers=1,
    num_frames=1,
    num_cameras=3,
)
FORMS = {"for onnxruntime": ("native", "compact"), "grid-sample": ("grid-sample", "grid-sample")}
GRID_SAMPLE = {19: (16, "bilinear"), 20: (20, "linear"), 21: (20, "linear"), 22: (22, "linear")}  # version, mode
DEFORM_CONV = {19: 19, 20: 19, 21: 19, 22: 22}


@pytest.fixture(scope="module")
def model() -> DuoSpaceNet:
    return randomise(DuoSpaceNet(CONFIG), 3).eval()


@pytest.fixture(scope="module")
def files(model, tmp_path_factory) -> dict[tuple[int, str], Path]:
    """The graph of the whole model by version and form.

    To save time, it is traced once, and only the first and the last version are exported. The exporter converts the
    graph to a version in its last step, and so do 20 and 21 here. Its translation for 22 of an operator is the newest
    up to 22, so one for 20 or 21 would be in the graph of 22 too, which is compared with that of 19.
    """
    graph, folder = stateless_graph(model), tmp_path_factory.mktemp("opsets")
    files = {(opset, form): folder / f"{opset} {form}.onnx" for opset in OPSETS for form in FORMS}
    examples = tuple(torch.empty(spec.shape, dtype=spec.dtype) for spec in graph.inputs.values())
    with mock.patch.object(torch.export, "export", return_value=torch.export.export(graph.module, examples)):
        for opset, form in itertools.product((OPSETS[0], OPSETS[-1]), FORMS):
            trace(graph, files[opset, form], OperatorForms(*FORMS[form], opset))
    for opset, form in itertools.product(OPSETS[1:-1], FORMS):
        converted = onnx_ir.load(files[OPSETS[0], form])
        version_converter.convert_version(converted, opset, fallback=False)
        onnx_ir.save(converted, files[opset, form])
    return files


@pytest.fixture(scope="module")
def inputs() -> dict[str, torch.Tensor]:
    """A frame of three cameras, one of them lost."""
    window = random_window(CONFIG, 1, seed=4)
    window.camera_valid[0, 2] = False
    return dict(zip(INPUTS, (random_images(CONFIG, 1, seed=4), *window), strict=True))


@pytest.fixture(scope="module")
def expected(model, inputs) -> list[torch.Tensor]:
    """The outputs of PyTorch in eager mode."""
    with torch.inference_mode():
        return list(StatelessModel(model)(*inputs.values()))


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("opset", OPSETS)
def test_the_graph_equals_the_model_in_every_version_and_form(files, inputs, expected, opset, form):
    found = session_on_pool(files[opset, form]).run(None, {name: value.numpy() for name, value in inputs.items()})
    for result, reference in zip(found, expected, strict=True):
        assert_close(torch.from_numpy(result), reference, 1e-4)


@pytest.mark.parametrize("opset", OPSETS)
def test_the_grid_sample_form_equals_the_model_in_openvino_in_every_version(files, inputs, expected, opset):
    options = {"INFERENCE_PRECISION_HINT": "f32"}
    compiled = openvino.Core().compile_model(files[opset, "grid-sample"], "CPU", options)
    found = compiled({name: value.numpy() for name, value in inputs.items()})
    for result, reference in zip(found.values(), expected, strict=True):
        assert_close(torch.from_numpy(np.array(result)), reference, 1e-4)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("opset", OPSETS)
def test_the_file_has_the_version_and_its_operators_have_the_attributes_of_that_version(files, opset, form):
    assert check_file(files[opset, form]) == {"": opset}
    nodes = onnx.load(files[opset, form]).graph.node
    version, mode = GRID_SAMPLE[opset]
    assert onnx.defs.get_schema("GridSample", opset).since_version == version
    assert onnx.defs.get_schema("DeformConv", opset).since_version == DEFORM_CONV[opset]
    samples = [attributes(node) for node in nodes if node.op_type == "GridSample"]
    assert samples == [{"mode": mode.encode(), "padding_mode": b"zeros", "align_corners": 0}] * len(samples)
    assert samples
    assert ("DeformConv" in {node.op_type for node in nodes}) == (form != "grid-sample")


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("opset", OPSETS[1:])
def test_the_graphs_of_all_versions_differ_only_in_the_mode_of_grid_sample(files, opset, form):
    first, other = (onnx.load(files[each, form]) for each in (OPSETS[0], opset))
    for node, twin in zip(first.graph.node, other.graph.node, strict=True):
        assert (node.op_type, node.input, len(node.output)) == (twin.op_type, twin.input, len(twin.output))
        modes = {"mode"} if node.op_type == "GridSample" else set()
        assert attributes(node, without=modes) == attributes(twin, without=modes)
    constants = [{tensor.name: tensor.raw_data for tensor in each.graph.initializer} for each in (first, other)]
    assert constants[0] == constants[1]


# The parts of an operator's definition that later versions add to the one of 19. An exported graph has none of them.
ADDED = {
    "GridSample": {"mode"},  # renamed: bilinear to linear, bicubic to cubic
    "DequantizeLinear": {"block_size"},
    "QuantizeLinear": {"block_size", "output_dtype"},
}


@pytest.mark.parametrize("operator", sorted(OPERATORS[DEFAULT_OPSET]))
def test_an_operator_has_the_same_inputs_outputs_and_defaults_in_every_version(operator):
    first = onnx.defs.get_schema(operator, OPSETS[0])
    for opset in OPSETS[1:]:
        other = onnx.defs.get_schema(operator, opset)
        assert [value.name for value in (*first.inputs, *first.outputs)] == [
            value.name for value in (*other.inputs, *other.outputs)
        ]
        changed = {
            name
            for name in first.attributes.keys() | other.attributes.keys()
            if describe(first, name) != describe(other, name)
        }
        assert changed <= ADDED.get(operator, set())


def describe(schema: onnx.defs.OpSchema, name: str) -> tuple | None:
    """Type and default of an attribute, or None for an unknown name."""
    found = schema.attributes.get(name)
    return None if found is None else (found.type, found.required, found.default_value.SerializeToString())


def attributes(node: onnx.NodeProto, without: set[str] = frozenset()) -> dict:
    return {each.name: helper.get_attribute_value(each) for each in node.attribute if each.name not in without}


# --- The parity check ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("opset", "mode", "differences"),
    [
        (19, "bilinear", []),
        (19, None, []),
        (19, "linear", ["expected GridSample with mode bilinear; got linear"]),
        (19, "bicubic", ["expected GridSample with mode bilinear; got bicubic"]),
        (20, "linear", []),
        (22, None, []),
        (20, "bilinear", ["expected GridSample with mode linear; got bilinear"]),
    ],
)
def test_the_mode_of_grid_sample_must_be_that_of_the_operator_set(opset, mode, differences):
    """Without the attribute, GridSample has the default mode of its version."""
    chosen = {"mode": mode} if mode else {}
    node = helper.make_node("GridSample", ["x", "grid"], ["y"], padding_mode="zeros", align_corners=0, **chosen)
    graph = helper.make_model(helper.make_graph([node], "g", [], []), opset_imports=[helper.make_opsetid("", opset)])
    found = attribute_differences("decoder", graph, {}, torch.nn.Identity())
    assert [str(each) for each in found] == [f"decoder.y: {text}" for text in differences]


SMALLEST = replace(PRESETS["tiny-pv"], preset="tiny-smallest", num_layers=1, num_frames=1, num_cameras=1)


@pytest.fixture
def smallest_preset(monkeypatch):
    """A preset that is exported in a few seconds."""
    monkeypatch.setitem(PRESETS, SMALLEST.preset, SMALLEST)
    with share_conversions():
        yield ["--preset", SMALLEST.preset, "--random-weights"]


def test_parity_inspect_and_bench_use_the_version_that_the_option_chooses(smallest_preset, tmp_path, capfd):
    bundle = str(tmp_path / "bundle")
    assert run_app(["export", *smallest_preset, "--opset", "22", "--out", bundle]) == 0
    assert {name: graph.opsets for name, graph in read_manifest(Path(bundle)).graphs.items()} == {
        "backbone": {"": 22},
        "decoder": {"": 22},
    }
    capfd.readouterr()
    assert run_app(["inspect", bundle]) == 0
    assert "operators  ONNX operator set 22" in capfd.readouterr().out
    assert run_app(["parity", bundle, *smallest_preset, "--random-inputs", "1", "--json"]) == 0
    parity = json.loads(capfd.readouterr().out)
    assert parity["passed"]
    assert parity["retrace"]["graphs"] == ["backbone", "decoder"]
    alternative = Target(name="stateless", kind="stateless", bundle=Path(bundle), threads=1)
    described = Worker(alternative).export_stateless(str(tmp_path / "stateless.onnx"), "native")
    assert described["opsets"] == check_file(tmp_path / "stateless.onnx") == {"": 22}


def test_a_graph_of_another_version_than_the_others_fails_parity(smallest_preset, tmp_path, capfd):
    bundle = tmp_path / "bundle"
    assert run_app(["export", *smallest_preset, "--out", str(bundle)]) == 0
    edit_graph(bundle, "decoder", to_opset_20)
    edit_manifest(bundle, lambda manifest: manifest["graphs"]["decoder"].update(opsets={"": 20}))
    capfd.readouterr()
    assert run_app(["parity", str(bundle), *smallest_preset, "--random-inputs", "1", "--no-retrace"]) == 1
    assert "field graphs.decoder.opsets" in " ".join(capfd.readouterr().out.split())


def to_opset_20(model: onnx.ModelProto) -> None:
    model.opset_import[0].version = 20
    for node in model.graph.node:
        for attribute in node.attribute:
            if node.op_type == "GridSample" and attribute.name == "mode":
                attribute.s = b"linear"


# --- Other versions -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("opset", [18, 23, 0, -1])
def test_another_version_is_refused_before_anything_is_built_and_the_message_names_the_range(tmp_path, capfd, opset):
    out = tmp_path / "bundle"
    command = ["export", "--preset", "tiny", "--random-weights", "--opset", str(opset), "--out", str(out)]
    assert run_app(command) == 2
    assert f"--opset: expected 19 to 22; got {opset}" in " ".join(capfd.readouterr().err.split())
    with pytest.raises(UsageError, match=f"expected 19 to 22; got {opset}"):
        jobs.export_model("tiny", out, random_weights=True, opset=opset)
    with pytest.raises(UsageError, match=f"expected 19 to 22; got {opset}"):
        export_bundle(DuoSpaceNet(SMALLEST), out, opset=opset)
    assert list(tmp_path.iterdir()) == []


def test_a_version_that_is_no_number_is_refused(tmp_path, capfd):
    command = ["export", "--preset", "tiny", "--random-weights", "--opset", "latest", "--out", str(tmp_path / "b")]
    assert run_app(command) == 2
    assert "--opset" in capfd.readouterr().err
