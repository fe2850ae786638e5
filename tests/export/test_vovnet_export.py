"""A model with a VoVNet through the whole export, odd sizes included."""

import onnx
import torch
from vovnets import TINY

from duospacenet.export import export_bundle
from duospacenet.model import DuoSpaceNet, randomise
from duospacenet.runtime.manifest import read_manifest


def test_a_vovnet_becomes_a_proven_bundle_of_plain_operators(tmp_path):
    model = randomise(DuoSpaceNet(TINY))
    report = export_bundle(model, tmp_path / "bundle")
    assert report.passed, report.failures
    assert max(error.relative for graph in report.graphs.values() for error in graph.values()) <= 1e-4

    graph = onnx.load(tmp_path / "bundle" / "backbone.onnx").graph
    operators = [node.op_type for node in graph.node]
    assert operators.count("MaxPool") == 3  # between the four stages
    assert operators.count("HardSigmoid") == sum(TINY.backbone.depths)
    assert not {"BatchNormalization", "AveragePool", "If", "Loop"} & set(operators)

    outputs = {
        tensor.name: tuple(tensor.shape) for tensor in read_manifest(tmp_path / "bundle").graphs["backbone"].outputs
    }
    with torch.no_grad():
        levels = model.image_encoder(torch.zeros(6, 80, 208, 3, dtype=torch.uint8))
    assert [outputs[f"pv_{j}"] for j in range(4)] == [tuple(level.shape) for level in levels]
