"""Tests of the initial weights, against the definitions that they follow."""

import math

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from torch import nn

from duospacenet.model import PRESETS, DuoSpaceNet, randomise
from duospacenet.model.attention import DeformableAttention
from duospacenet.model.backbones.deformable_convolution import DeformableConvolution
from duospacenet.model.backbones.resnet import ResNet
from duospacenet.model.config import ResNetConfig
from duospacenet.model.decoder import PredictionHeads
from duospacenet.training import initialise
from duospacenet.training.initialisation import initialise_modules

TINY = PRESETS["tiny"]
ALL_TINY = [name for name in PRESETS if name.startswith("tiny")]
ANCHORS = torch.linspace(-40, 40, 3 * TINY.num_queries, dtype=torch.float64).reshape(-1, 3)


@pytest.fixture(scope="module")
def model() -> DuoSpaceNet:
    return initialise(DuoSpaceNet(TINY), 0, ANCHORS).eval()


def modules_of(model, kind):
    modules = [module for module in model.modules() if isinstance(module, kind)]
    assert modules
    return modules


def window(config):
    """Arguments of `forward`: random images, and an ego that does not move."""
    generator, frames, cameras = torch.Generator().manual_seed(0), config.num_frames, config.num_cameras
    size = (config.image.height_px, config.image.width_px)
    image_T_ego = torch.tensor([[80.0, -60, 0, 0], [32, 0, -60, 90], [1, 0, 0, 0]])
    return (
        torch.randint(0, 256, (frames, cameras, *size, 3), dtype=torch.uint8, generator=generator),
        image_T_ego.expand(frames, cameras, 3, 4),
        torch.eye(4).expand(frames, 4, 4),
        0.5 * torch.arange(frames),
        torch.ones(frames, dtype=torch.bool),
        torch.ones(frames, cameras, dtype=torch.bool),
    )


# --- Predictions --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ALL_TINY)
def test_every_layer_predicts_the_initial_poses_of_the_queries(name):
    config = PRESETS[name]
    model = initialise(DuoSpaceNet(config), 3, ANCHORS).eval()
    with torch.no_grad():
        predictions = model(*window(config)).predictions
    assert len(predictions) == config.num_layers
    for prediction in predictions:
        torch.testing.assert_close(prediction.pose[..., :3].reshape(-1, 3)[: len(ANCHORS)], ANCHORS.float())
        assert prediction.pose.reshape(-1).equal(model.queries.pose.reshape(-1))


def test_every_class_score_of_every_query_is_about_0_01(model):
    with torch.no_grad():
        predictions = model(*window(TINY)).predictions
    for prediction in predictions:
        scores = prediction.class_logits.sigmoid()
        assert scores.log().mean().exp().item() == pytest.approx(0.01, rel=0.05)
        assert scores.max() < 0.02


def test_the_class_score_of_zero_content_is_exactly_the_prior(model):
    for heads in modules_of(model, PredictionHeads):
        scores = heads(torch.zeros(1, 2 * TINY.channels), torch.zeros(1, 10)).class_logits.sigmoid()
        assert scores.detach().numpy() == pytest.approx(np.full((1, 10), 0.01), rel=1e-5)


def test_the_zero_layer_of_the_refinement_gets_a_gradient(model):
    """The layers before it are not zero."""
    heads = modules_of(model, PredictionHeads)[0]
    content = torch.randn(4, 2 * TINY.channels, generator=torch.Generator().manual_seed(0))
    heads(content, torch.zeros(4, 10)).pose.sum().backward()
    assert heads.refinement[-1].weight.grad.abs().max() > 0.01
    model.zero_grad()


def test_queries_without_anchors_are_spread_over_the_perception_range():
    pose = initialise(DuoSpaceNet(TINY), 0).queries.pose
    assert pose[:, :2].abs().max() <= 51.2
    assert pose[:, :2].std(dim=0).min() > 20  # 29.6 m for a uniform distribution


def test_the_content_of_the_queries_is_normal_or_xavier_for_each_space():
    """Xavier: uniform in ±√(6 / (Q + C)), where Q queries have C channels per space."""
    normal, xavier = (
        initialise(DuoSpaceNet(TINY), 0, content_init=kind).queries.content for kind in ("normal", "xavier")
    )
    assert normal.std().item() == pytest.approx(1, rel=0.05)
    bound = math.sqrt(6 / (TINY.num_queries + TINY.channels))
    assert TINY.content_channels == 2 * TINY.channels
    for content in xavier.chunk(2, dim=-1):
        assert 0.95 * bound < content.abs().max() <= bound
        assert content.std().item() == pytest.approx(bound / math.sqrt(3), rel=0.1)


def test_a_wrong_number_of_anchors_is_refused():
    with pytest.raises(ValueError, match=r"one centre per query, shape \(32, 3\); got \(31, 3\)"):
        initialise(DuoSpaceNet(TINY), 0, ANCHORS[1:])


# --- Modules ------------------------------------------------------------------------------------------------------


def test_deformable_attention_samples_outward_and_weights_all_points_equally(model):
    query = torch.randn(1, 5, TINY.channels, generator=torch.Generator().manual_seed(0))
    for attention in modules_of(model, DeformableAttention):
        num_heads, num_levels, num_points = attention.num_heads, attention.num_levels, attention.num_points
        offsets, weights = attention.offsets_and_weights(query)
        torch.testing.assert_close(weights, torch.full_like(weights, 1 / (num_levels * num_points)))
        cells = offsets[0].detach().numpy()
        for head in range(num_heads):
            angle = 2 * math.pi * head / num_heads
            direction = np.array([math.cos(angle), math.sin(angle)])
            for point in range(num_points):
                expected = (point + 1) * direction / np.abs(direction).max()
                np.testing.assert_allclose(
                    cells[:, head, :, point], np.broadcast_to(expected, (5, num_levels, 2)), atol=1e-5
                )


def test_linear_layers_have_xavier_weights_and_zero_biases(model):
    """Uniform in ±√(6 / (inputs + outputs)), also for the value projection of deformable attention."""
    suffixes = (".value", ".feedforward.0", ".query_key_value")
    layers = [layer for name, layer in model.decoder.named_modules() if name.endswith(suffixes)]
    assert len(layers) == 4 * TINY.num_layers
    for layer in layers:
        bound = math.sqrt(6 / (layer.weight.shape[0] + layer.weight.shape[1]))
        assert 0.95 * bound < layer.weight.abs().max() <= bound
        assert layer.weight.std().item() == pytest.approx(bound / math.sqrt(3), rel=0.1)
        assert not layer.bias.any()


def test_convolutions_have_kaiming_weights_by_their_outputs(model):
    """Normal, with a variance of 2 / (outputs · kernel size)."""
    for convolution in (model.image_encoder.backbone.layer4[0].conv1, model.divergence_enhancement.conv2d[1][0]):
        outputs, _, *kernel = convolution.weight.shape
        assert convolution.weight.std().item() == pytest.approx(math.sqrt(2 / (outputs * math.prod(kernel))), rel=0.05)
        assert convolution.bias is None or not convolution.bias.any()


def test_normalisations_are_the_identity_and_have_new_running_statistics():
    model = initialise(randomise(DuoSpaceNet(TINY), 1), 0)
    for norm in modules_of(model, (nn.BatchNorm2d, nn.BatchNorm3d)):
        assert norm.running_mean.eq(0).all()
        assert norm.running_var.eq(1).all()
    for norm in modules_of(model, (nn.BatchNorm2d, nn.BatchNorm3d, nn.LayerNorm)):
        assert norm.weight.eq(1).all()
        assert norm.bias.eq(0).all()


def test_a_new_deformable_convolution_equals_half_an_ordinary_convolution():
    backbone = ResNet(ResNetConfig("bottleneck", (1, 1, 1, 1), width=8, deformable_stages=(4,)))
    (convolution,) = modules_of(backbone, DeformableConvolution)
    nn.init.normal_(convolution.conv_offset.weight)
    initialise_modules(backbone, torch.Generator().manual_seed(0))
    generator = torch.Generator().manual_seed(1)
    x = torch.randn(1, convolution.weight.shape[1], 6, 7, generator=generator)
    expected = F.conv2d(x, convolution.weight, stride=convolution.stride, padding=1) / 2
    torch.testing.assert_close(convolution(x), expected, atol=1e-5, rtol=1e-4)
    assert convolution.weight.std().item() == pytest.approx(math.sqrt(2 / (9 * len(convolution.weight))), rel=0.05)


# --- Determinism --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ALL_TINY)
def test_every_tensor_depends_on_the_seed_only(name):
    models = []
    with torch.random.fork_rng():
        for global_seed in (1, 2):
            torch.manual_seed(global_seed)
            models.append(initialise(randomise(DuoSpaceNet(PRESETS[name]), global_seed), 5))
    tensors, others = (model.state_dict() for model in models)
    assert [key for key, tensor in tensors.items() if not tensor.equal(others[key])] == []


def test_the_global_generator_of_torch_is_left_unchanged():
    model = DuoSpaceNet(TINY)
    before = torch.get_rng_state()
    initialise(model, 0)
    assert torch.get_rng_state().equal(before)


def test_another_seed_gives_other_weights():
    first, other = (initialise(DuoSpaceNet(TINY), seed).state_dict() for seed in (0, 1))
    for name in ("image_encoder.backbone.conv1.weight", "decoder.layers.0.feedforward.0.weight", "queries.pose"):
        assert not first[name].equal(other[name])
