"""VoVNetV2 against Lee & Park (2020), and the published names, numbers and strides."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from duospacenet.model import PRESETS, DuoSpaceNet, randomise
from duospacenet.model.backbones.vovnet import EffectiveSqueezeExcitation, OneShotAggregation, VoVNet
from duospacenet.model.config import VoVNetConfig
from duospacenet.model.image_encoder import ImageEncoder
from tests.helpers import references
from tests.helpers.model_inputs import assert_close, normal, random_images, random_window, with_random_weights
from tests.helpers.vovnets import SMALL, TINY, published_shapes

EPS = 0.25  # of BatchNorm, large enough that a wrong value is noticed
V2_99 = PRESETS["large"].backbone


# --- The equations --------------------------------------------------------------------------------------------------


def convolution(weights, name, x, stride=1):
    """Convolution, BatchNorm and ReLU: 3×3 with zero padding, or 1×1."""
    kernel = weights[f"{name}/conv.weight"]
    normed = references.batch_norm(
        references.part(weights, f"{name}/norm"), references.convolve(kernel, x, stride, kernel.shape[-1] // 2), EPS
    )
    return references.relu(normed)


def effective_squeeze_excitation(weights, x):
    """A_eSE = σ(W_C F_gap(X)), multiplied with the channels of X. σ is the hard sigmoid of the published code."""
    averages = np.array([channel.mean() for channel in x])
    attention = weights["fc.weight"][:, :, 0, 0] @ averages + weights["fc.bias"]
    gates = [min(max(a + 3, 0), 6) / 6 for a in attention]
    return np.stack([gate * channel for gate, channel in zip(gates, x, strict=True)])


def one_shot_aggregation(weights, name, x, num_convolutions, identity):
    """A sequence of convolutions, then a 1×1 convolution of the input and all their outputs."""
    features = [x]
    for index in range(num_convolutions):
        features.append(convolution(weights, f"layers.{index}.{name}_{index}", features[-1]))
    aggregated = convolution(weights, f"concat.{name}_concat", np.concatenate(features))
    weighted = effective_squeeze_excitation(references.part(weights, "ese"), aggregated)
    return weighted + x if identity else weighted


def pool(x):
    """The maximum of 3×3 pixels with stride 2. With an even size, the last window has two pixels."""
    starts = [range(0, size - 1, 2) for size in x.shape[1:]]
    return np.stack(
        [np.stack([x[:, i : i + 3, j : j + 3].max(axis=(1, 2)) for j in starts[1]], axis=-1) for i in starts[0]], axis=1
    )


def vovnet(weights, image, config):
    """Lee & Park's network with the strides of their code: image (3, H, W) to C3, C4, C5."""
    x = image
    for number, stride in ((1, 2), (2, 1), (3, 2)):
        x = convolution(weights, f"stem.stem_{number}", x, stride)
    features = []
    for stage, depth in zip((2, 3, 4, 5), config.depths, strict=True):
        x = x if stage == 2 else pool(x)
        for number in range(1, depth + 1):
            name = f"OSA{stage}_{number}"
            module = references.part(weights, f"stage{stage}.{name}")
            x = one_shot_aggregation(module, name, x, config.num_convolutions, identity=number > 1)
        features.append(x)
    return features[1:]


def test_the_excitation_equals_a_case_of_four_channels_by_hand():
    """The means are 4, -1, 2 and 1. The layer makes them 4, 0, -4 and 1.5. The gates are 1, 1/2, 0 and 3/4."""
    x = torch.tensor([[1.0, 3, 5, 7], [-1, -1, 1, -3], [2, 2, 0, 4], [0, 4, 0, 0]]).reshape(1, 4, 2, 2)
    excitation = EffectiveSqueezeExcitation(4)
    with torch.no_grad():
        weight = torch.tensor([[1.0, 0, 0, 0], [0.5, 1, 0, 0], [0, 0, -2, 0], [0, 0, 0, 0.5]])
        excitation.fc.weight.copy_(weight.reshape(4, 4, 1, 1))
        excitation.fc.bias.copy_(torch.tensor([0.0, -1, 0, 1]))
        weighted = excitation(x)
    expected = torch.tensor([[1.0, 3, 5, 7], [-0.5, -0.5, 0.5, -1.5], [0, 0, 0, 0], [0, 3, 0, 0]]).reshape(1, 4, 2, 2)
    torch.testing.assert_close(weighted, expected)


def test_every_image_has_gates_from_its_own_means():
    excitation, x = with_random_weights(EffectiveSqueezeExcitation(5)).double(), normal(3, 5, 4, 6, seed=1).double()
    weighted = excitation(x)
    for n in range(3):
        expected = effective_squeeze_excitation(references.weights_of(excitation), x[n].numpy())
        assert_close(weighted[n], expected, 1e-12)


@pytest.mark.parametrize("identity", [False, True])
@pytest.mark.parametrize("num_convolutions", [1, 3, 5])
def test_an_aggregation_equals_its_equations(identity, num_convolutions):
    config = replace(SMALL, num_convolutions=num_convolutions, batch_norm_eps=EPS)
    module = with_random_weights(OneShotAggregation("OSA4_2", 8, 5, 8, identity, config)).double()
    x = normal(2, 8, 6, 7, seed=1).double()
    aggregated = module(x)
    for n in range(2):
        expected = one_shot_aggregation(
            references.weights_of(module), "OSA4_2", x[n].numpy(), num_convolutions, identity
        )
        assert_close(aggregated[n], expected, 1e-12)


@pytest.mark.parametrize("size", [(64, 96), (80, 208), (74, 110)])
def test_the_features_equal_the_equations(size):
    """Even sizes and odd ones, in the stem and before each pooling."""
    config = replace(SMALL, batch_norm_eps=EPS)
    network, image = with_random_weights(VoVNet(config)).double(), normal(2, 3, *size, seed=1).double()
    features = network(image)
    for n in range(2):
        expected = vovnet(references.weights_of(network), image[n].numpy(), config)
        assert len(features) == len(expected) == 3
        for level, expected_level in zip(features, expected, strict=True):
            assert_close(level[n], expected_level, 1e-10)


# --- The published numbers --------------------------------------------------------------------------------------------


def shapes_of(network):
    return {name: tuple(tensor.shape) for name, tensor in network.state_dict().items()}


def num_parameters(config):
    with torch.device("meta"):
        return sum(parameter.numel() for parameter in VoVNet(config).parameters())


@pytest.mark.parametrize("config", [SMALL, V2_99], ids=["small", "V2-99"])
def test_the_state_dict_is_the_published_one(config):
    with torch.device("meta"):
        assert shapes_of(VoVNet(config)) == published_shapes(config)


def test_v2_99_has_as_many_tensors_as_the_published_file():
    """fcos3d_vovnet_imgbackbone-remapped.pth, the initial weights of PETR, has 626 tensors under img_backbone."""
    with torch.device("meta"):
        network = VoVNet(V2_99)
    assert len(network.state_dict()) == 626
    assert {
        "stem.stem_1/conv.weight",
        "stage2.OSA2_1.layers.0.OSA2_1_0/conv.weight",
        "stage2.OSA2_1.concat.OSA2_1_concat/norm.running_var",
        "stage4.OSA4_9.ese.fc.bias",
        "stage5.OSA5_3.layers.4.OSA5_3_4/norm.weight",
    } < set(network.state_dict())


@pytest.mark.parametrize(("depths", "millions"), [((1, 1, 4, 3), 68.9), (V2_99.depths, 96.9)], ids=["V2-57", "V2-99"])
def test_deeper_networks_exceed_v2_39_by_the_published_number_of_parameters(depths, millions):
    """vovnet-detectron2's table of Faster R-CNN: 52.6 M with V2-39. All parts except the backbone are the same."""
    more = num_parameters(replace(V2_99, depths=depths)) - num_parameters(replace(V2_99, depths=(1, 1, 2, 2)))
    assert more / 1e6 == pytest.approx(millions - 52.6, abs=0.1)


def test_v2_39_has_the_published_parameters():
    """timm's ese_vovnet39b has 24.6 M, of which its classifier has 1,025,000. Only its last modules have an eSE, so it
    lacks those of OSA4_1 and OSA5_1, each with a matrix and a bias.
    """
    excitations = 768 * 768 + 768 + 1024 * 1024 + 1024
    classifier = 1024 * 1000 + 1000
    published = num_parameters(replace(V2_99, depths=(1, 1, 2, 2))) - excitations + classifier
    assert round(published / 1e6, 1) == 24.6


# --- The sizes --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("width_px", "height_px", "sizes"),
    [
        (160, 64, [(8, 20), (4, 10), (2, 5), (1, 3)]),
        (208, 80, [(10, 26), (5, 13), (2, 6), (1, 3)]),
        (400, 160, [(20, 50), (10, 25), (5, 12), (3, 6)]),
        (800, 320, [(40, 100), (20, 50), (10, 25), (5, 13)]),
        (1600, 640, [(80, 200), (40, 100), (20, 50), (10, 25)]),
    ],
)
def test_the_levels_have_strides_8_16_32_and_64(width_px, height_px, sizes):
    """25 columns become 12, not 13 as in ResNet, because the pooling has no padding. The pyramid enlarges 12 to 25."""
    with torch.device("meta"):
        encoder = ImageEncoder(TINY)
        levels = encoder(torch.zeros(2, height_px, width_px, 3, dtype=torch.uint8))
        features = encoder.backbone(torch.zeros(2, 3, height_px, width_px))
    assert [tuple(level.shape) for level in levels] == [(2, 32, *size) for size in sizes]
    assert [feature.shape[1] for feature in features] == encoder.backbone.out_channels == [10, 11, 12]


@pytest.mark.parametrize("height_px", [16, 24])
def test_an_image_with_a_single_row_before_a_pooling_is_refused(height_px):
    """16 rows are 4, 2 and 1 before the last pooling; 24 are 6, 3 and 1."""
    with pytest.raises(RuntimeError, match="too small"):
        VoVNet(SMALL)(torch.zeros(1, 3, height_px, 64))


def test_the_configuration_selects_the_backbone():
    with torch.device("meta"):
        large, base = DuoSpaceNet(PRESETS["large"]), DuoSpaceNet(PRESETS["base"])
    assert shapes_of(large.image_encoder.backbone) == published_shapes(V2_99)
    assert large.image_encoder.backbone.out_channels == [512, 768, 1024]
    assert "layer3.22.conv3.weight" in base.image_encoder.backbone.state_dict()


# --- Random weights ---------------------------------------------------------------------------------------------------

# As deep as V2-99, with its convolutions per module and its ratios of channels; and a network without identities.
DEEP = VoVNetConfig(stem=(16, 16, 32), widths=(32, 40, 48, 56), out_channels=(64, 128, 192, 256))
SHALLOW = replace(DEEP, depths=(1, 1, 1, 1))


@pytest.mark.parametrize("backbone", [DEEP, SHALLOW], ids=["deep", "shallow"])
@pytest.mark.parametrize("seed", [0, 1])
def test_random_weights_let_no_stage_explode_or_vanish(backbone, seed):
    config = replace(TINY, backbone=backbone)
    model, window, sizes, spreads = randomise(DuoSpaceNet(config), seed).eval(), random_window(config, 2), [], []

    def note(_, __, output):
        sizes.append(output.square().mean().sqrt().item())
        spreads.append(output.std(dim=(2, 3)).mean().item())

    for module in model.modules():
        if isinstance(module, OneShotAggregation):
            module.register_forward_hook(note)
    with torch.no_grad():
        output = model(random_images(config, 2), *window)

    assert len(sizes) == 2 * sum(backbone.depths)  # in each of the two frames
    assert all(0.2 < size < 10 for size in sizes), sizes
    assert all(spread > 0.05 for spread in spreads), spreads
    assert all(0.05 < prediction.class_logits.std() < 10 for prediction in output.predictions)
    assert all(0.05 < mask.std() < 10 for mask in output.maps.values())
