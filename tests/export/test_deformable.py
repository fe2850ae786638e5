"""Deformable convolutions in a graph file, in both forms: as DeformConv, and taken apart into GridSample and others."""

import shutil
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, get_args

import numpy as np
import onnx
import pytest
import torch

from duospacenet.cli.main import run_app
from duospacenet.export import bisect_parity, export_bundle
from duospacenet.export.bisection.intermediates import Intermediates
from duospacenet.export.graphs import Graph
from duospacenet.export.manifest_builder import manifest
from duospacenet.export.tracing import trace
from duospacenet.model import PRESETS, DuoSpaceNet, randomise
from duospacenet.model.backbones.deformable_convolution import DeformableConvolution
from duospacenet.model.config import ResNetConfig
from duospacenet.runtime import Pipeline
from duospacenet.runtime.bundle.graph_file import check_graph_file
from duospacenet.runtime.bundle.manifest import DeformableForm, WeightsRecord, read_manifest
from tests.faults.catalogue import ONE_FRAME
from tests.helpers import references
from tests.helpers.bundles import edit_graph
from tests.helpers.exports import session_on_pool
from tests.helpers.model_inputs import assert_close, normal, with_random_weights

FORMS = get_args(DeformableForm)
OPERATORS = {"native": ("DeformConv", "GridSample"), "grid-sample": ("GridSample", "DeformConv")}  # it has, has not

# Strides in the 3×3, so that both strides are deformable.
DEFORMABLE = replace(
    PRESETS["tiny"],
    preset="tiny-dcn",
    backbone=ResNetConfig("bottleneck", (1, 1, 2, 1), width=8, deformable_stages=(3, 4)),
    num_layers=1,
    num_frames=2,
)


class Traced(NamedTuple):
    """A graph in both forms: the files, and the programs they came of."""

    graph: Graph
    files: dict[str, Path]
    programs: dict[str, torch.export.ExportedProgram]


@pytest.fixture(scope="module", params=[1, 2], ids=["stride 1", "stride 2"])
def traced(request, tmp_path_factory) -> Traced:
    """A deformable convolution alone, of two images."""
    module, x = with_random_weights(DeformableConvolution(5, 4, request.param)), normal(2, 5, 14, 19, seed=1)
    with torch.no_grad():
        graph = Graph("backbone", module, {"x": x}, {"y": module(x)})
    files = {form: tmp_path_factory.mktemp(form) / "graph.onnx" for form in FORMS}
    return Traced(graph, files, {form: trace(graph, files[form], form) for form in FORMS})


def operators(path: Path) -> set[str]:
    return {node.op_type for node in onnx.load(path).graph.node}


def run(path: Path, x: torch.Tensor) -> torch.Tensor:
    return torch.from_numpy(session_on_pool(path).run(None, {"x": x.numpy()})[0])


@pytest.mark.parametrize(("scale", "relative"), [(0.25, 1e-5), (10, 5e-5)], ids=["near", "far outside"])
def test_both_forms_equal_the_equation_and_each_other(traced, scale, relative):
    """The offsets grow with the input: from half a pixel to twice the size of the map."""
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
def test_the_map_is_zero_at_offsets_of_any_size(traced, form):
    """Offsets of 10²⁵ px: onnxruntime's GridSample by itself would take the border for that."""
    assert run(traced.files[form], 1e25 * normal(2, 5, 14, 19, seed=2)).count_nonzero() == 0


@pytest.mark.parametrize("form", FORMS)
def test_a_form_has_its_operator_and_not_the_others(traced, form):
    has, has_not = OPERATORS[form]
    assert has in operators(traced.files[form])
    assert has_not not in operators(traced.files[form])


@pytest.mark.parametrize("form", FORMS)
def test_a_form_is_of_operators_that_the_runtime_accepts(traced, form):
    assert check_graph_file(traced.files[form]) == {"": 20}


@pytest.mark.parametrize(("form", "on_the_way"), [("native", "sigmoid"), ("grid-sample", "grid_sampler")])
def test_the_traced_program_computes_the_files_tensors_in_eager_mode(traced, form, on_the_way):
    graph, file = traced.graph, onnx.load(traced.files[form])
    intermediates = Intermediates(traced.programs[form], graph.outputs)
    assert {on_the_way, "y"} <= intermediates.names & {output for node in file.graph.node for output in node.output}
    assert intermediates.origin(on_the_way).source.startswith("model/deformable_convolution.py:")
    assert_close(torch.from_numpy(intermediates.values(["y"], graph.inputs)["y"]), graph.outputs["y"], 1e-6)


@pytest.fixture(scope="module")
def model() -> DuoSpaceNet:
    return randomise(DuoSpaceNet(DEFORMABLE), seed=0).eval()


@pytest.fixture(scope="module")
def bundles(model, tmp_path_factory) -> dict[str, Path]:
    """The whole model, exported and proven in both forms, in one of them by the command line."""
    bundles = {form: tmp_path_factory.mktemp("bundles") / form for form in FORMS}
    assert export_bundle(model, bundles["native"]).passed
    command = ["export", "--preset", DEFORMABLE.preset, "--random-weights", "--dcn", "grid-sample"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(PRESETS, DEFORMABLE.preset, DEFORMABLE)
        assert run_app([*command, "--out", str(bundles["grid-sample"])]) == 0
    return bundles


@pytest.mark.parametrize("form", FORMS)
def test_a_whole_bundle_passes_parity_in_either_form(bundles, form):
    assert Pipeline.load(bundles[form]).manifest.parity.passed
    has, has_not = OPERATORS[form]
    assert has in operators(bundles[form] / "backbone.onnx")
    assert has_not not in operators(bundles[form] / "backbone.onnx")


@pytest.mark.parametrize(("form", "words"), [("native", "as DeformConv"), ("grid-sample", "in GridSample")])
def test_a_bundle_says_in_which_form_it_is(bundles, form, words, capfd):
    assert read_manifest(bundles[form]).dcn == form
    assert run_app(["inspect", str(bundles[form])]) == 0
    assert f"DCN        deformable convolutions {words}" in capfd.readouterr().out


def test_without_deformable_convolutions_there_is_no_form():
    weights = WeightsRecord(source="none", sha256="0" * 64, trained=None)
    forms = {config: manifest(config, weights, [], {}, "grid-sample").dcn for config in (PRESETS["tiny"], DEFORMABLE)}
    assert list(forms.values()) == [None, "grid-sample"]


WRONG = {"native": ("DeformConv", "pads", [0, 0, 2, 2]), "grid-sample": ("GridSample", "align_corners", 1)}


@pytest.mark.parametrize("form", FORMS)
def test_a_bisection_traces_the_bundles_own_form_and_finds_a_wrong_deformable_convolution(
    bundles, model, tmp_path, form
):
    operator, attribute, value = WRONG[form]

    def spoil(file: onnx.ModelProto) -> None:
        node = next(node for node in file.graph.node if node.op_type == operator)
        others = [other for other in node.attribute if other.name != attribute]
        del node.attribute[:]
        node.attribute.extend([*others, onnx.helper.make_attribute(attribute, value)])

    bundle = edit_graph(Path(shutil.copytree(bundles[form], tmp_path / "bundle")), "backbone", spoil)
    found = bisect_parity(bundle, model, ONE_FRAME)
    assert (found.kind, found.graph, found.module) == ("tensor", "backbone", "image_encoder.backbone.layer3.0.conv2")
    assert [line.split(" is ")[0] for line in found.remarks] == [f"{operator}: attribute {attribute}"]
