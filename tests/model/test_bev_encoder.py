"""Feature divergence enhancement equals its equations: three Conv3D, Z into the channels, three Conv2D."""

import pytest
import torch

from duospacenet.model.bev_encoder import FeatureDivergenceEnhancement
from tests.helpers import references
from tests.helpers.model_inputs import ASYMMETRIC, assert_close, normal, with_random_weights


def test_the_enhancement_equals_its_equations():
    enhancement = with_random_weights(FeatureDivergenceEnhancement(ASYMMETRIC)).double()
    voxels = normal(1, 8, 4, 12, 8, seed=1).double()
    bev = enhancement(voxels)
    assert bev.shape == (1, 32, 12, 8)
    expected = references.divergence_enhancement(references.weights_of(enhancement), voxels[0].numpy())
    assert_close(bev[0], expected, 1e-10)


@pytest.mark.parametrize(("channel", "z"), [(0, 0), (2, 1), (7, 3)])
def test_height_z_of_channel_c_becomes_channel_c_times_4_plus_z(channel, z):
    """The convolutions copy their input, and one of them selects a single channel."""
    enhancement = with_random_weights(FeatureDivergenceEnhancement(ASYMMETRIC))
    with torch.no_grad():
        for block in (*enhancement.conv3d, *enhancement.conv2d):
            convolution, norm, _ = block
            centre = (slice(None), slice(None), *[1] * (convolution.weight.ndim - 2))
            convolution.weight.zero_()
            convolution.weight[centre] = torch.eye(*convolution.weight.shape[:2])
            for tensor, value in ((norm.weight, 1), (norm.bias, 0), (norm.running_mean, 0), (norm.running_var, 1)):
                tensor.fill_(value)
        first = enhancement.conv2d[0][0].weight
        first.zero_()
        first[5, channel * 4 + z, 1, 1] = 1
    voxels = normal(1, 8, 4, 12, 8, seed=1).abs()
    torch.testing.assert_close(enhancement(voxels)[0, 5], voxels[0, channel, z], rtol=1e-4, atol=1e-4)
