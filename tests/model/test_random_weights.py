"""Random weights depend on the seed only, no tensor is constant, and no activation explodes."""

from dataclasses import replace

import pytest
import torch

from duospacenet.model import PRESETS, DuoSpaceNet, randomise
from duospacenet.model.backbones.deformable_convolution import DeformableConvolution
from tests.helpers.model_inputs import random_images, random_window

TINY = PRESETS["tiny"]


def constructed(global_seed):
    with torch.random.fork_rng():
        torch.manual_seed(global_seed)
        return DuoSpaceNet(TINY)


def assert_same(model, other):
    for (name, tensor), (other_name, other_tensor) in zip(
        model.state_dict().items(), other.state_dict().items(), strict=True
    ):
        assert name == other_name
        assert torch.equal(tensor, other_tensor), name


def test_the_weights_depend_on_the_seed_only():
    model, other = constructed(1), constructed(2)
    assert not torch.equal(model.queries.pose, other.queries.pose)
    assert_same(randomise(model, 5), randomise(other, 5))


def test_the_previous_weights_of_the_model_have_no_effect():
    model, other = randomise(randomise(constructed(1), 4), 5), randomise(constructed(1), 5)
    assert_same(model, other)


def test_the_state_of_torchs_global_generator_is_not_used_and_not_changed():
    model, other = constructed(1), constructed(1)
    with torch.random.fork_rng():
        torch.manual_seed(9)
        before = torch.get_rng_state()
        randomise(model, 5)
        assert torch.equal(torch.get_rng_state(), before)
        torch.manual_seed(10)
        randomise(other, 5)
    assert_same(model, other)


def test_another_seed_changes_every_tensor():
    weights, others = randomise(constructed(1), 5).state_dict(), randomise(constructed(1), 6).state_dict()
    same = [name for name, tensor in weights.items() if torch.equal(tensor, others[name])]
    assert all(name.endswith("num_batches_tracked") for name in same)


def test_no_tensor_is_constant_or_has_a_nan(tiny_model):
    for name, tensor in tiny_model.state_dict().items():
        if name.endswith("num_batches_tracked"):
            continue
        assert tensor.isfinite().all(), name
        assert tensor.ne(0).all() if tensor.numel() == 1 else tensor.min() < tensor.max(), name


def test_all_tensors_differ_so_that_a_swap_is_detected(tiny_model):
    tensors = [t for name, t in tiny_model.state_dict().items() if not name.endswith("num_batches_tracked")]
    for i, tensor in enumerate(tensors):
        assert not any(torch.equal(tensor, other) for other in tensors[i + 1 :])


# As deep as the preset `small`, and also with pixels that are not divided by their deviation.
DEEP = replace(
    TINY,
    image=replace(PRESETS["small"].image, width_px=160, height_px=64),
    backbone=replace(PRESETS["small"].backbone, width=8),
)


# As deep as the preset `base`, with deformable convolutions in 26 blocks.
DEFORMABLE = replace(
    TINY,
    image=replace(PRESETS["base"].image, width_px=160, height_px=64),
    backbone=replace(PRESETS["base"].backbone, width=16),
)


@pytest.mark.parametrize("config", [TINY, DEEP, DEFORMABLE], ids=["tiny", "deep", "deformable"])
def test_every_activation_is_finite_and_of_moderate_size(config):
    model, window, sizes = randomise(DuoSpaceNet(config)).eval(), random_window(config, 2), []

    def note(_, __, output):
        if isinstance(output, torch.Tensor):
            sizes.append(output.abs().max().item() if output.isfinite().all() else float("inf"))

    for module in model.modules():
        module.register_forward_hook(note)
    with torch.no_grad():
        output = model(random_images(config, 2), *window)

    assert len(sizes) > 100
    assert max(sizes) < 1000
    for prediction in output.predictions:
        assert 0.05 < prediction.class_logits.std() < 10
    assert all(0.05 < mask.std() < 10 for mask in output.maps.values())


def test_the_queries_cover_the_perception_range(tiny_model):
    pose = tiny_model.queries.pose
    assert pose[:, :2].abs().max() <= 51.2
    assert pose[:, :2].std(dim=0).min() > 20  # a uniform distribution has 29.6 m


def test_deformable_convolutions_have_varied_masks_and_offsets_that_cross_the_border():
    model, moves = randomise(DuoSpaceNet(DEFORMABLE)).eval(), []

    def note(module, inputs, _):
        offsets, logits = module.conv_offset(inputs[0]).split((18, 9), dim=1)
        moves.append((offsets, logits.sigmoid()))

    for module in model.modules():
        if isinstance(module, DeformableConvolution):
            module.register_forward_hook(note)
    with torch.no_grad():
        model.image_encoder(random_images(DEFORMABLE, 1)[0])

    assert len(moves) == 26
    for offsets, masks in moves:
        assert 0.5 < offsets.std() < 6
        assert offsets[:, 0::2, 0].min() < -1  # above the first row, outside the map
        assert 0.1 < masks.std() < 0.45
