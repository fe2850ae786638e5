"""Random weights: from the seed alone, nothing constant, nothing exploding."""

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


def test_the_weights_are_a_function_of_the_seed_alone():
    model, other = constructed(1), constructed(2)
    assert not torch.equal(model.queries.pose, other.queries.pose)
    assert_same(randomise(model, 5), randomise(other, 5))


def test_what_the_model_held_before_does_not_matter():
    model, other = randomise(randomise(constructed(1), 4), 5), randomise(constructed(1), 5)
    assert_same(model, other)


def test_the_state_of_torchs_own_generator_neither_matters_nor_changes():
    model, other = constructed(1), constructed(1)
    with torch.random.fork_rng():
        torch.manual_seed(9)
        before = torch.get_rng_state()
        randomise(model, 5)
        assert torch.equal(torch.get_rng_state(), before)
        torch.manual_seed(10)
        randomise(other, 5)
    assert_same(model, other)


def test_another_seed_gives_other_weights_everywhere():
    weights, others = randomise(constructed(1), 5).state_dict(), randomise(constructed(1), 6).state_dict()
    same = [name for name, tensor in weights.items() if torch.equal(tensor, others[name])]
    assert all(name.endswith("num_batches_tracked") for name in same)


def test_no_tensor_is_constant_and_none_holds_a_nan(tiny_model):
    for name, tensor in tiny_model.state_dict().items():
        if name.endswith("num_batches_tracked"):
            continue
        assert tensor.isfinite().all(), name
        assert tensor.ne(0).all() if tensor.numel() == 1 else tensor.min() < tensor.max(), name


def test_no_two_tensors_are_alike_so_that_a_swap_shows(tiny_model):
    tensors = [t for name, t in tiny_model.state_dict().items() if not name.endswith("num_batches_tracked")]
    for i, tensor in enumerate(tensors):
        assert not any(torch.equal(tensor, other) for other in tensors[i + 1 :])


# As deep as the small preset, and like it with pixels that are not divided by their deviation.
DEEP = replace(
    TINY,
    image=replace(PRESETS["small"].image, width_px=160, height_px=64),
    backbone=replace(PRESETS["small"].backbone, width=8),
)


# As deep as the base preset, with deformable convolutions in 26 blocks.
DEFORMABLE = replace(
    TINY,
    image=replace(PRESETS["base"].image, width_px=160, height_px=64),
    backbone=replace(PRESETS["base"].backbone, width=16),
)


@pytest.mark.parametrize("config", [TINY, DEEP, DEFORMABLE], ids=["tiny", "deep", "deformable"])
def test_every_activation_is_finite_and_of_a_sane_size(config):
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


def test_the_queries_are_spread_over_the_perception_range(tiny_model):
    pose = tiny_model.queries.pose
    assert pose[:, :2].abs().max() <= 51.2
    assert pose[:, :2].std(dim=0).min() > 20  # of a uniform spread: 29.6 m


def test_deformable_convolutions_look_around_over_the_border_too_and_weigh_what_they_see():
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
        assert offsets[:, 0::2, 0].min() < -1  # up from the first row: out of the map
        assert 0.1 < masks.std() < 0.45
