"""ResNet against He et al. (2016), torchvision's names and numbers, and the published weights."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors import safe_open

from duospacenet.model import PRESETS
from duospacenet.model.backbones.resnet import BasicBlock, Bottleneck, ResNet
from duospacenet.model.config import ResNetConfig
from tests.helpers import references
from tests.helpers.model_inputs import assert_close, normal, with_random_weights

IMAGENET = (
    Path(__file__).resolve().parents[4]
    / "shared"
    / "data"
    / "resnet50_imagenet"
    / "resnet50_caffe_imagenet.safetensors"
)

RESNET_18 = ResNetConfig("basic", (2, 2, 2, 2))
RESNET_50 = ResNetConfig("bottleneck", (3, 4, 6, 3))


def published_shapes(config):
    """The names and shapes of torchvision's state dict without `fc`."""
    expansion, width = (4, 64) if config.block == "bottleneck" else (1, 64)
    shapes = {"conv1.weight": (64, 3, 7, 7), **batch_norm_shapes("bn1", 64)}
    inputs = 64
    for stage, depth in enumerate(config.depths):
        width = 64 * 2**stage
        for index in range(depth):
            block = f"layer{stage + 1}.{index}"
            if config.block == "bottleneck":
                kernels = [(width, inputs, 1, 1), (width, width, 3, 3), (4 * width, width, 1, 1)]
            else:
                kernels = [(width, inputs, 3, 3), (width, width, 3, 3)]
            for number, kernel in enumerate(kernels, start=1):
                shapes[f"{block}.conv{number}.weight"] = kernel
                shapes |= batch_norm_shapes(f"{block}.bn{number}", kernel[0])
            if index == 0 and (stage > 0 or expansion > 1):
                shapes[f"{block}.downsample.0.weight"] = (expansion * width, inputs, 1, 1)
                shapes |= batch_norm_shapes(f"{block}.downsample.1", expansion * width)
            inputs = expansion * width
    return shapes


def batch_norm_shapes(name, channels):
    numbers = ("weight", "bias", "running_mean", "running_var")
    return {f"{name}.{number}": (channels,) for number in numbers} | {f"{name}.num_batches_tracked": ()}


# torchvision's resnet18 has 122 tensors and 11,689,512 parameters, 2 and 513,000 of them in fc; its resnet50 has
# 320 and 25,557,032, with 2 and 2,049,000.
@pytest.mark.parametrize(
    ("config", "num_tensors", "num_parameters"), [(RESNET_18, 120, 11_176_512), (RESNET_50, 318, 23_508_032)]
)
@pytest.mark.parametrize("caffe_style", [False, True])
def test_the_state_dict_is_torchvisions(config, num_tensors, num_parameters, caffe_style):
    with torch.device("meta"):
        network = ResNet(replace(config, caffe_style=caffe_style))
    shapes = {name: tuple(tensor.shape) for name, tensor in network.state_dict().items()}
    assert shapes == published_shapes(config)
    assert len(shapes) == num_tensors
    assert sum(parameter.numel() for parameter in network.parameters()) == num_parameters


@pytest.mark.skipif(not IMAGENET.is_file(), reason="the ImageNet weights are not beside this checkout")
def test_the_imagenet_weights_fit_the_small_preset_exactly():
    with torch.device("meta"):
        network = ResNet(PRESETS["small"].backbone)
    with safe_open(IMAGENET, framework="pt") as file:
        published = {name: tuple(file.get_slice(name).get_shape()) for name in file.keys()}  # noqa: SIM118
    shapes = {name: tuple(tensor.shape) for name, tensor in network.state_dict().items()}
    classifier = {"fc.weight": (1000, 2048), "fc.bias": (1000,)}
    assert published == shapes | classifier


@pytest.mark.parametrize("block", ["basic", "bottleneck"])
@pytest.mark.parametrize("caffe_style", [False, True])
def test_the_features_equal_the_equations(block, caffe_style):
    config = ResNetConfig(block, (1, 2, 1, 1), width=4, caffe_style=caffe_style, batch_norm_eps=0.25)
    network, image = with_random_weights(ResNet(config)).double(), normal(2, 3, 38, 66, seed=1).double()
    features = network(image)
    for n in range(2):
        expected = references.resnet(
            references.weights_of(network), image[n].numpy(), config.depths, config.caffe_style, eps=0.25
        )
        for level, expected_level in zip(features, expected, strict=True):
            assert_close(level[n], expected_level, 1e-10)


@pytest.mark.parametrize("caffe_style", [False, True])
def test_the_features_of_a_deformable_resnet_equal_the_equations(caffe_style):
    config = ResNetConfig("bottleneck", (1, 1, 2, 1), 4, caffe_style, 0.25, deformable_stages=(3, 4))
    network, image = with_random_weights(ResNet(config)).double(), normal(3, 38, 66, seed=1).double()
    expected = references.resnet(references.weights_of(network), image.numpy(), config.depths, caffe_style, eps=0.25)
    for level, expected_level in zip(network(image[None]), expected, strict=True):
        assert_close(level[0], expected_level, 1e-10)


# mmdetection's `stage_with_dcn=(False, False, True, True)`: 27 channels of offsets and masks from each 3×3's input.
def test_the_base_preset_has_mmdetections_names_of_deformable_convolutions():
    config = PRESETS["base"].backbone
    with torch.device("meta"):
        network = ResNet(config)
    shapes = {name: tuple(tensor.shape) for name, tensor in network.state_dict().items()}
    offsets = {}
    for stage, depth, width in ((3, 23, 256), (4, 3, 512)):
        for index in range(depth):
            offsets[f"layer{stage}.{index}.conv2.conv_offset.weight"] = (27, width, 3, 3)
            offsets[f"layer{stage}.{index}.conv2.conv_offset.bias"] = (27,)
    assert shapes == published_shapes(config) | offsets


@pytest.mark.parametrize("config", [RESNET_18, RESNET_50])
def test_the_features_have_strides_8_16_and_32(config):
    network = ResNet(replace(config, width=4))
    sizes = [tuple(level.shape[-2:]) for level in network(torch.zeros(1, 3, 96, 160))]
    assert sizes == [(12, 20), (6, 10), (3, 5)]


@pytest.mark.parametrize("block", [BasicBlock, Bottleneck])
def test_a_caffe_style_bottleneck_ignores_every_other_pixel(block):
    """A 1×1 convolution with stride 2 does not use the odd pixels. A 3×3 convolution does."""
    x = normal(1, 8, 6, 6, seed=1)
    changed = x.clone()
    changed[..., 1::2, :] += 1
    changed[..., :, 1::2] += 1
    same = {}
    for caffe_style in (False, True):
        config = ResNetConfig("bottleneck", (1, 1, 1, 1), caffe_style=caffe_style)
        layer = with_random_weights(block(8, 8, stride=2, config=config))
        assert layer(x).shape[-2:] == (3, 3)
        same[caffe_style] = torch.equal(layer(x), layer(changed))
    assert same == {False: False, True: block is Bottleneck}
