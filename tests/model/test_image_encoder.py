"""The image encoder: its normalisation, its feature pyramid, and the sizes of the levels."""

from dataclasses import replace

import pytest
import torch
import torch.nn.functional as F

from duospacenet.model import PRESETS
from duospacenet.model.image_encoder import FeaturePyramid, ImageEncoder
from tests.helpers import references
from tests.helpers.model_inputs import assert_close, normal, with_random_weights

TINY = PRESETS["tiny"]


def normalised(colour_order, mean, std, bgr):
    """One BGR pixel after the normalisation."""
    image = replace(TINY.image, colour_order=colour_order, mean=mean, std=std)
    encoder = ImageEncoder(replace(TINY, image=image))
    pixels = encoder.normalisation(torch.tensor(bgr, dtype=torch.uint8).reshape(1, 1, 1, 3))
    assert pixels.shape == (1, 3, 1, 1)
    return pixels.flatten()


def test_an_rgb_network_gets_red_first_minus_its_mean_over_its_deviation():
    """Blue 10, green 20, red 30: (30 - 1) / 2, (20 - 2) / 3, (10 - 3) / 4."""
    pixel = normalised("rgb", (1.0, 2.0, 3.0), (2.0, 3.0, 4.0), (10, 20, 30))
    torch.testing.assert_close(pixel, torch.tensor([14.5, 6.0, 1.75]))


def test_a_bgr_network_gets_blue_first():
    pixel = normalised("bgr", (1.0, 2.0, 3.0), (2.0, 3.0, 4.0), (10, 20, 30))
    torch.testing.assert_close(pixel, torch.tensor([4.5, 6.0, 6.75]))


def test_the_presets_normalise_as_their_imagenet_weights_require():
    """torchvision: red 0.485, 0.229; green 0.456, 0.224; blue 0.406, 0.225 of 255. Caffe: blue first, minus
    103.939, 116.779, 123.68.
    """
    bgr = (255, 128, 0)
    torchvision = torch.tensor([(0 - 0.485) / 0.229, (128 / 255 - 0.456) / 0.224, (1 - 0.406) / 0.225])
    torch.testing.assert_close(normalised(*normalisation("nano"), bgr), torchvision)
    torch.testing.assert_close(normalised(*normalisation("small"), bgr), torch.tensor([151.061, 11.221, -123.68]))


def normalisation(preset):
    image = PRESETS[preset].image
    return image.colour_order, image.mean, image.std


def test_images_keep_their_height_and_width():
    images = torch.zeros(2, 64, 160, 3, dtype=torch.uint8)
    images[1, 5, 100] = 255
    pixels = ImageEncoder(TINY).normalisation(images)
    assert pixels.shape == (2, 3, 64, 160)
    assert (pixels[1, 0] == pixels[1, 0].max()).nonzero().tolist() == [[5, 100]]


@pytest.mark.parametrize(
    ("width_px", "height_px", "sizes"),
    [
        (160, 64, [(8, 20), (4, 10), (2, 5), (1, 3)]),
        (400, 160, [(20, 50), (10, 25), (5, 13), (3, 7)]),
        (800, 320, [(40, 100), (20, 50), (10, 25), (5, 13)]),
    ],
)
def test_the_levels_have_strides_8_16_32_and_64(width_px, height_px, sizes):
    levels = ImageEncoder(TINY).eval()(torch.zeros(2, height_px, width_px, 3, dtype=torch.uint8))
    assert [tuple(level.shape) for level in levels] == [(2, 32, *size) for size in sizes]


def odd_sized_features():
    """Random C3, C4 and C5. The pyramid enlarges 13 columns to 25 by the nearest neighbour."""
    return [normal(1, *shape, seed=1).double() for shape in ((3, 10, 25), (4, 5, 13), (5, 3, 7))]


def test_the_pyramid_equals_its_equations():
    pyramid = with_random_weights(FeaturePyramid([3, 4, 5], 6)).double()
    features = odd_sized_features()
    levels = pyramid(features)
    expected = references.feature_pyramid(references.weights_of(pyramid), [level[0].numpy() for level in features])
    assert len(levels) == len(expected) == 4
    for level, expected_level in zip(levels, expected, strict=True):
        assert_close(level[0], expected_level, 1e-12)


def mmdetection_fpn(weights, c3, c4, c5, relu_before_extra_convs=False):
    """Five outputs of mmdetection's FPN with `add_extra_convs="on_output"`, without a loop.

    weights: by mmdetection's names. The two extra levels are `fpn_convs.3` and `fpn_convs.4`.
    """

    def convolve(name, features, **options):
        return F.conv2d(features, weights[f"{name}.conv.weight"], weights[f"{name}.conv.bias"], **options)

    merged_5 = convolve("lateral_convs.2", c5)
    merged_4 = convolve("lateral_convs.1", c4) + F.interpolate(merged_5, size=c4.shape[2:], mode="nearest")
    merged_3 = convolve("lateral_convs.0", c3) + F.interpolate(merged_4, size=c3.shape[2:], mode="nearest")
    p3 = convolve("fpn_convs.0", merged_3, padding=1)
    p4 = convolve("fpn_convs.1", merged_4, padding=1)
    p5 = convolve("fpn_convs.2", merged_5, padding=1)
    p6 = convolve("fpn_convs.3", p5, stride=2, padding=1)  # no ReLU before the first extra level
    p7 = convolve("fpn_convs.4", F.relu(p6) if relu_before_extra_convs else p6, stride=2, padding=1)
    return [p3, p4, p5, p6, p7]


@pytest.fixture
def mmdetection_weights():
    """Random weights of an FPN with two extra levels, by mmdetection's names."""
    shapes = {f"lateral_convs.{i}": (6, channels, 1, 1) for i, channels in enumerate((3, 4, 5))}
    shapes |= {f"fpn_convs.{i}": (6, 6, 3, 3) for i in range(5)}
    weights = {f"{name}.conv.weight": normal(*shape, seed=i).double() for i, (name, shape) in enumerate(shapes.items())}
    return weights | {f"{name}.conv.bias": normal(6, seed=20 + i).double() for i, name in enumerate(shapes)}


def pyramid_with(weights):
    """A feature pyramid with weights of mmdetection's FPN. It does not have the second extra level."""
    pyramid = FeaturePyramid([3, 4, 5], 6).double()
    names = {f"output.{i}": f"fpn_convs.{i}" for i in range(3)}
    names |= {f"lateral.{i}": f"lateral_convs.{i}" for i in range(3)} | {"extra": "fpn_convs.3"}
    kinds = ("weight", "bias")
    pyramid.load_state_dict({f"{a}.{kind}": weights[f"{b}.conv.{kind}"] for a, b in names.items() for kind in kinds})
    return pyramid


@pytest.mark.parametrize("relu_before_extra_convs", [False, True])
def test_all_four_levels_equal_those_of_mmdetections_fpn_on_equal_weights(mmdetection_weights, relu_before_extra_convs):
    features = odd_sized_features()
    levels = pyramid_with(mmdetection_weights)(features)
    expected = mmdetection_fpn(mmdetection_weights, *features, relu_before_extra_convs)
    assert len(levels) == 4
    for level, expected_level in zip(levels, expected[:4], strict=True):
        torch.testing.assert_close(level, expected_level, rtol=1e-12, atol=1e-12)


def test_relu_before_extra_convs_changes_the_second_extra_level_of_mmdetections_fpn_only(mmdetection_weights):
    features = odd_sized_features()
    without = mmdetection_fpn(mmdetection_weights, *features)
    with_relu = mmdetection_fpn(mmdetection_weights, *features, relu_before_extra_convs=True)
    assert [torch.equal(a, b) for a, b in zip(without, with_relu, strict=True)] == [True, True, True, True, False]


def test_the_encoder_applies_normalisation_backbone_and_pyramid():
    encoder = with_random_weights(ImageEncoder(TINY), std=0.1).double()
    images = torch.randint(0, 256, (1, 64, 160, 3), dtype=torch.uint8, generator=torch.Generator().manual_seed(0))
    rgb = images[0].double().numpy()[..., ::-1]
    weights = references.weights_of(encoder)
    stages = references.resnet(
        references.part(weights, "backbone"),
        ((rgb - TINY.image.mean) / TINY.image.std).transpose(2, 0, 1),
        TINY.backbone.depths,
        TINY.backbone.caffe_style,
        TINY.backbone.batch_norm_eps,
    )
    expected = references.feature_pyramid(references.part(weights, "neck"), stages)
    for level, expected_level in zip(
        encoder.neck(encoder.backbone(encoder.normalisation(images).double())), expected, strict=True
    ):
        assert_close(level[0], expected_level, 1e-5)
