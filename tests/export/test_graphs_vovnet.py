"""A model with a VoVNet backbone exports to a bundle, with odd feature map sizes too."""

import onnx
import torch

from duospacenet.export import export_bundle
from duospacenet.export.graphs import Graph
from duospacenet.export.tracing import trace
from duospacenet.model import DuoSpaceNet, randomise
from duospacenet.model.backbones.vovnet import EffectiveSqueezeExcitation
from duospacenet.runtime.bundle.manifest import read_manifest
from tests.helpers.exports import session_on_pool
from tests.helpers.vovnets import TINY


def test_a_vovnet_exports_to_plain_operators_and_passes_parity(tmp_path):
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
    expected = [(6, TINY.voxel_channels, *level.shape[2:]) for level in levels]
    assert [outputs[f"reduced_pv_{j}"] for j in range(4)] == expected


def test_the_mean_of_a_constant_map_is_exact_in_onnxruntime(tmp_path):
    """A lost camera gives a constant map; its size here is that of `large`.

    With the weight 6 and the bias -3, the HardSigmoid returns the mean itself, so the output is x times the mean.
    """
    excitation, level = EffectiveSqueezeExcitation(1), 0.7137
    with torch.no_grad():
        excitation.fc.weight.fill_(6)
        excitation.fc.bias.fill_(-3)
    x = torch.full((1, 1, 160, 400), level)
    trace(Graph("backbone", excitation, {"x": x}, {"y": x}), tmp_path / "graph.onnx")
    (result,) = session_on_pool(tmp_path / "graph.onnx").run(None, {"x": x.numpy()})
    assert abs(result / level**2 - 1).max() < 1e-5
