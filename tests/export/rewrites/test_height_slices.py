"""The 3D convolutions of feature divergence enhancement become 2D convolutions of height slices."""

from dataclasses import replace

import pytest
import torch
from torch import nn

from duospacenet.export.rewrites.height_slices import SlicedEnhancement, slice_heights
from duospacenet.model.bev_encoder import FeatureDivergenceEnhancement
from duospacenet.model.config import VoxelGrid
from tests.helpers import references
from tests.helpers.model_inputs import ASYMMETRIC, assert_close, normal, with_random_weights
from tests.helpers.rewritten_models import CONFIGS, called_operators, model_of, outputs, outputs_of, rewritten_by

WITHOUT = {"pv", "no-fde", "bev-no-fde"}


@pytest.mark.parametrize("name", ["tiny", "bev", "stacking", "one height", "two heights", "three heights"])
def test_the_outputs_of_the_model_stay(name):
    rewritten = outputs(rewritten_by(slice_heights, name))
    for output, expected in outputs_of(name).items():
        # The roundings of all layers add up.
        assert_close(rewritten[output], expected, 5e-5)


@pytest.mark.parametrize("num_heights", [1, 2, 3, 4, 6])
def test_the_sliced_enhancement_equals_the_loop(num_heights):
    config = replace(ASYMMETRIC, voxels=VoxelGrid((8, 4, num_heights)))
    plain = with_random_weights(FeatureDivergenceEnhancement(config), std=0.1).requires_grad_(False)
    weights = references.weights_of(plain)
    voxels = normal(1, 8, num_heights, 8, 4, seed=1)
    expected = references.divergence_enhancement(weights, voxels[0].double().numpy())
    assert_close(SlicedEnhancement(plain, num_heights)(voxels)[0], expected, 1e-5)


def test_heights_with_the_same_neighbours_share_their_convolutions():
    """Of six heights the four inner ones do: three kinds with two, three and two heights as inputs."""
    plain = FeatureDivergenceEnhancement(replace(ASYMMETRIC, voxels=VoxelGrid((8, 4, 6)))).eval().requires_grad_(False)
    sliced = SlicedEnhancement(plain, 6)
    assert [[convolution.in_channels for convolution in layer] for layer in sliced.conv3d] == [[16, 24, 16]] * 3


@pytest.mark.parametrize("name", sorted(CONFIGS.keys() - WITHOUT))
def test_no_3d_convolution_and_no_3d_batch_norm_remains(name):
    rewritten = rewritten_by(slice_heights, name)
    kinds = {type(module) for module in rewritten.modules()}
    assert not kinds & {nn.Conv3d, nn.BatchNorm3d}
    assert {nn.Conv3d, nn.BatchNorm3d} <= {type(module) for module in model_of(name).modules()}


@pytest.mark.parametrize("name", sorted(WITHOUT))
def test_a_model_without_3d_convolutions_is_not_changed(name):
    rewritten = rewritten_by(slice_heights, name)
    before = model_of(name).state_dict()
    assert rewritten.state_dict().keys() == before.keys()
    assert all(torch.equal(tensor, before[key]) for key, tensor in rewritten.state_dict().items())


def test_every_height_is_convolved_once_per_layer():
    before = called_operators(model_of("tiny"))
    after = called_operators(rewritten_by(slice_heights, "tiny"))
    three_layers, frames, heights = 3, 3, 4
    name = "aten.convolution.default"
    assert after[name] - before[name] == frames * three_layers * (heights - 1)
