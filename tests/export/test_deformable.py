"""Both ONNX forms of deformable convolutions: DeformConv, and a formula built on GridSample."""

import shutil
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, get_args

import numpy as np
import onnx
import pytest
import torch

from duospacenet.cli.main import run_app
from duospacenet.export import bisect_parity, check_parity, export_bundle
from duospacenet.export.bisection.intermediates import Intermediates
from duospacenet.export.graphs import Graph
from duospacenet.export.manifest_builder import build_manifest
from duospacenet.export.operator_forms import OperatorForms
from duospacenet.export.tracing import trace
from duospacenet.model import PRESETS, DuoSpaceNet, randomise
from duospacenet.model.backbones.deformable_convolution import DeformableConvolution
from duospacenet.model.config import ResNetConfig
from duospacenet.runtime import Pipeline
from duospacenet.runtime.bundle.manifest import DeformableForm, WeightsRecord, read_manifest
from tests.faults.catalogue import ONE_FRAME
from tests.helpers import references
from tests.helpers.bundles import check_file, edit_graph, edit_manifest
from tests.helpers.exports import session_on_pool, share_conversions
from tests.helpers.model_inputs import assert_close, normal, with_random_weights

FORMS = get_args(DeformableForm)
OPERATORS = {"native": ("DeformConv", "GridSample"), "grid-sample": ("GridSample", "DeformConv")}  # present, absent

# A bottleneck has its stride in the 3×3 convolution, so deformable convolutions with stride 1 and 2 occur.
DEFORMABLE = replace(
    PRESETS["tiny"],
    preset="tiny-dcn",
    backbone=ResNetConfig("bottleneck", (1, 1, 2, 1), width=8, deformable_stages=(3, 4)),
    num_layers=1,
    num_frames=2,
)


class Traced(NamedTuple):
    """A graph with its file and its traced program in both forms."""

    graph: Graph
    files: dict[str, Path]
    programs: dict[str, torch.export.ExportedProgram]


@pytest.fixture(scope="module", params=[1, 2], ids=["stride 1", "stride 2"])
def traced(request, tmp_path_factory) -> Traced:
    """A single deformable convolution of two images."""
    module, x = with_random_weights(DeformableConvolution(5, 4, request.param)), normal(2, 5, 14, 19, seed=1)
    with torch.no_grad():
        graph = Graph("backbone", module, {"x": x}, {"y": module(x)})
    files = {form: tmp_path_factory.mktemp(form) / "graph.onnx" for form in FORMS}
    return Traced(graph, files, {form: trace(graph, files[form], OperatorForms(form)) for form in FORMS})


def operators(path: Path) -> set[str]:
    return {node.op_type for node in onnx.load(path).graph.node}


def run(path: Path, x: torch.Tensor) -> torch.Tensor:
    return torch.from_numpy(session_on_pool(path).run(None, {"x": x.numpy()})[0])


@pytest.mark.parametrize(("scale", "relative"), [(0.25, 1e-5), (10, 5e-5)], ids=["near", "far outside"])
def test_both_forms_equal_the_equation_and_each_other(traced, scale, relative):
    """The offsets grow with the input, from half a pixel to twice the size of the map."""
    module, x = traced.graph.module, scale * normal(2, 5, 14, 19, seed=2)
    expected = [
        references.deformable_convolution(references.weights_of(module), image, module.stride)
        for image in x.double().numpy()
    ]
    results = {form: run(path, x) for form, path in traced.files.items()}
    for result in results.values():
        assert_close(result, np.stack(expected), relative)
    assert_close(results["native"], results["grid-sample"], relative)


@pytest.mark.parametrize("form", FORMS)
def test_offsets_of_any_size_outside_the_map_give_zeros(traced, form):
    """At offsets of 10²⁵ px, onnxruntime's GridSample alone would return the border value."""
    assert run(traced.files[form], 1e25 * normal(2, 5, 14, 19, seed=2)).count_nonzero() == 0


@pytest.mark.parametrize("form", FORMS)
def test_a_form_contains_its_operator_and_not_that_of_the_other_form(traced, form):
    present, absent = OPERATORS[form]
    assert present in operators(traced.files[form])
    assert absent not in operators(traced.files[form])


@pytest.mark.parametrize("form", FORMS)
def test_the_runtime_accepts_the_operators_of_both_forms(traced, form):
    assert check_file(traced.files[form]) == {"": 19}


@pytest.mark.parametrize(("form", "intermediate"), [("native", "sigmoid"), ("grid-sample", "grid_sampler")])
def test_the_traced_program_computes_the_tensors_of_the_file(traced, form, intermediate):
    graph, file = traced.graph, onnx.load(traced.files[form])
    intermediates = Intermediates(traced.programs[form], graph.outputs)
    assert {intermediate, "y"} <= intermediates.names & {output for node in file.graph.node for output in node.output}
    assert intermediates.origin(intermediate).source.startswith("backbones/deformable_convolution.py:")
    assert_close(torch.from_numpy(intermediates.values(["y"], graph.inputs)["y"]), graph.outputs["y"], 1e-6)


@pytest.fixture(scope="module")
def model() -> DuoSpaceNet:
    return randomise(DuoSpaceNet(DEFORMABLE), seed=0).eval()


@pytest.fixture(scope="module")
def bundles(model, tmp_path_factory) -> dict[str, Path]:
    """The bundle in both forms, "native" from `export_bundle` and "grid-sample" from the command line."""
    bundles = {form: tmp_path_factory.mktemp("bundles") / form for form in FORMS}
    with share_conversions():
        assert export_bundle(model, bundles["native"]).passed
    command = ["export", "--preset", DEFORMABLE.preset, "--random-weights", "--dcn", "grid-sample"]
    with pytest.MonkeyPatch.context() as patch, share_conversions():
        patch.setitem(PRESETS, DEFORMABLE.preset, DEFORMABLE)
        assert run_app([*command, "--out", str(bundles["grid-sample"])]) == 0
    return bundles


@pytest.mark.parametrize("form", FORMS)
def test_a_bundle_passes_parity_in_both_forms(bundles, form):
    assert Pipeline.load(bundles[form]).manifest.parity.passed
    present, absent = OPERATORS[form]
    assert present in operators(bundles[form] / "backbone.onnx")
    assert absent not in operators(bundles[form] / "backbone.onnx")


@pytest.mark.parametrize(("form", "text"), [("native", "as DeformConv"), ("grid-sample", "as GridSample")])
def test_manifest_and_inspect_name_the_form(bundles, form, text, capfd):
    assert read_manifest(bundles[form]).dcn == form
    assert run_app(["inspect", str(bundles[form])]) == 0
    assert f"DCN        deformable convolutions {text}" in capfd.readouterr().out


def test_a_manifest_without_deformable_convolutions_has_no_form():
    weights = WeightsRecord(source="none", sha256="0" * 64, trained=None)
    forms = {
        config: build_manifest(config, weights, [], {}, OperatorForms("grid-sample")).dcn
        for config in (PRESETS["tiny"], DEFORMABLE)
    }
    assert list(forms.values()) == [None, "grid-sample"]


WRONG = {"native": ("DeformConv", "pads", [0, 0, 2, 2]), "grid-sample": ("GridSample", "align_corners", 1)}


@pytest.mark.parametrize("form", FORMS)
def test_a_bisection_finds_a_wrong_deformable_convolution_in_both_forms(bundles, model, tmp_path, form):
    operator, attribute, value = WRONG[form]

    def change_attribute(file: onnx.ModelProto) -> None:
        node = next(node for node in file.graph.node if node.op_type == operator)
        others = [other for other in node.attribute if other.name != attribute]
        del node.attribute[:]
        node.attribute.extend([*others, onnx.helper.make_attribute(attribute, value)])

    bundle = edit_graph(Path(shutil.copytree(bundles[form], tmp_path / "bundle")), "backbone", change_attribute)
    bisection = bisect_parity(bundle, model, stress_frames=ONE_FRAME)
    assert (bisection.kind, bisection.graph, bisection.module) == (
        "tensor",
        "backbone",
        "image_encoder.backbone.layer3.0.conv2",
    )
    assert [line.split(" is ")[0] for line in bisection.remarks] == [f"{operator}: attribute {attribute}"]


@pytest.mark.parametrize("form", FORMS)
def test_a_manifest_with_the_other_form_fails_parity(bundles, model, tmp_path, form):
    other = next(name for name in FORMS if name != form)
    bundle = Path(shutil.copytree(bundles[form], tmp_path / "bundle"))
    edit_manifest(bundle, lambda manifest: manifest.update(dcn=other))
    result = check_parity(bundle, model, stress_frames=ONE_FRAME, random_inputs=0)
    assert [str(difference) for difference in result.manifest] == [
        f"manifest.json: field dcn: expected {form!r}; got {other!r}"
    ]
