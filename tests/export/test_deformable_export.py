"""Deformable convolutions in a graph file, in both forms: as DeformConv, and taken apart into GridSample and others."""

import shutil
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import onnx
import onnxruntime as ort
import pytest
import references
import torch
from bundles import edit_graph, edit_manifest
from faults.catalogue import ONE_FRAME
from samples import assert_close, drawn, normal

from duospacenet.export import bisect_parity, export_bundle
from duospacenet.export.graphs import Graph
from duospacenet.export.intermediates import Intermediates
from duospacenet.export.tracing import trace
from duospacenet.model import PRESETS, DuoSpaceNet, randomise
from duospacenet.model.config import ResNetConfig
from duospacenet.model.deformable_convolution import DeformableConvolution
from duospacenet.runtime import Pipeline
from duospacenet.runtime.graph_file import check_graph_file
from duospacenet.runtime.manifest import DeformableForm, read_manifest

FORMS = get_args(DeformableForm)
OPERATORS = {"native": ("DeformConv", "GridSample"), "grid-sample": ("GridSample", "DeformConv")}  # it has, has not

# Strides in the 3×3, so that both strides are deformable.
DEFORMABLE = replace(
    PRESETS["tiny"],
    preset="tiny-dcn",
    backbone=ResNetConfig("bottleneck", (1, 1, 2, 1), width=8, deformable_stages=(3, 4)),
)


def graph_of(stride: int, spread_px: float) -> Graph:
    """A deformable convolution alone, of two images."""
    module = drawn(DeformableConvolution(5, 4, stride))
    module.conv_offset.weight.data *= spread_px
    x = normal(2, 5, 14, 19, seed=1)
    with torch.no_grad():
        return Graph("backbone", module, {"x": x}, {"y": module(x)})


def operators(path: Path) -> set[str]:
    return {node.op_type for node in onnx.load(path).graph.node}


def run(path: Path, x: torch.Tensor) -> torch.Tensor:
    session = ort.InferenceSession(path, providers=["CPUExecutionProvider"])
    return torch.from_numpy(session.run(None, {"x": x.numpy()})[0])


@pytest.mark.parametrize("spread_px", [0.5, 20])
@pytest.mark.parametrize("stride", [1, 2])
def test_both_forms_equal_the_equation_and_each_other(tmp_path, stride, spread_px):
    graph, other = graph_of(stride, spread_px), normal(2, 5, 14, 19, seed=2)
    weights, results = references.weights_of(graph.module), {}
    for form in FORMS:
        path = tmp_path / f"{form}.onnx"
        trace(graph, path, form)
        assert check_graph_file(path) == {"": 20}
        results[form] = run(path, other)
        for n in range(2):
            expected = references.deformable_convolution(weights, other[n].double().numpy(), stride)
            assert_close(results[form][n], expected, 1e-4 if spread_px > 1 else 2e-5)
    assert_close(results["native"], results["grid-sample"], 1e-4 if spread_px > 1 else 2e-5)


@pytest.mark.parametrize("form", FORMS)
def test_a_form_has_its_operator_and_not_the_others(tmp_path, form):
    trace(graph_of(1, 0.5), tmp_path / "graph.onnx", form)
    has, has_not = OPERATORS[form]
    assert has in operators(tmp_path / "graph.onnx")
    assert has_not not in operators(tmp_path / "graph.onnx")


@pytest.mark.parametrize("form", FORMS)
def test_the_traced_program_computes_the_files_tensors_in_eager_mode(tmp_path, form):
    graph, name = graph_of(1, 0.5), {"native": "sigmoid", "grid-sample": "grid_sampler"}[form]
    intermediates = Intermediates(trace(graph, tmp_path / "graph.onnx", form), graph.outputs)
    named = {output for node in onnx.load(tmp_path / "graph.onnx").graph.node for output in node.output}
    assert {name, "y"} <= named & intermediates.names
    assert intermediates.origin(name).source.startswith("model/deformable_convolution.py:")
    values = intermediates.values(["y", name], graph.inputs)
    assert np.abs(values["y"] - graph(graph.inputs)["y"].numpy()).max() < 1e-5


@pytest.fixture(scope="module")
def model() -> DuoSpaceNet:
    return randomise(DuoSpaceNet(DEFORMABLE)).eval()


@pytest.fixture(scope="module")
def bundles(model, tmp_path_factory) -> dict[str, Path]:
    """The whole model, exported and proven in both forms."""
    folder = tmp_path_factory.mktemp("deformable")
    for form in FORMS:
        report = export_bundle(model, folder / form, dcn=form)
        assert report.passed
    return {form: folder / form for form in FORMS}


@pytest.mark.parametrize("form", FORMS)
def test_a_whole_bundle_passes_parity_in_either_form_and_says_which(bundles, form):
    assert read_manifest(bundles[form]).dcn == form
    assert Pipeline.load(bundles[form]).manifest.parity.passed
    has, has_not = OPERATORS[form]
    assert has in operators(bundles[form] / "backbone.onnx")
    assert has_not not in operators(bundles[form] / "backbone.onnx")


def test_without_deformable_convolutions_there_is_no_form(tiny_bundle):
    assert read_manifest(tiny_bundle).dcn is None


def test_a_manifest_from_before_deformable_convolutions_reads(tiny_bundle, tmp_path):
    (tmp_path / "bundle").mkdir()
    (tmp_path / "bundle" / "manifest.json").write_bytes((tiny_bundle / "manifest.json").read_bytes())
    edit_manifest(tmp_path / "bundle", lambda manifest: manifest.pop("dcn"))
    assert read_manifest(tmp_path / "bundle").dcn is None


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
