"""Fusion of past BEV features: alignment, recurrent stacking and BEVFormer's temporal self-attention."""

import numpy as np
import pytest
import torch

from duospacenet.model.bev_fusion import EgoAlignment, RecurrentStacking, TemporalSelfAttention
from tests.helpers import references
from tests.helpers.model_inputs import ASYMMETRIC, assert_close, bev_features, random_window, rigid, with_random_weights

FRAMES = 3
FUSIONS = {
    RecurrentStacking: references.recurrent_stacking,
    TemporalSelfAttention: references.temporal_self_attention,
}
VALID = [(True, True, True), (True, False, True), (True, True, False), (True, False, False)]


def frames_of(num_frames):
    return [bev_features(ASYMMETRIC, seed=t) for t in range(num_frames)]


def window_with(*valid):
    return random_window(ASYMMETRIC, len(valid))._replace(frame_valid=torch.tensor(valid))


def arrays_of(window):
    return {"past_T_now": window.past_T_now.double().numpy(), "frame_valid": window.frame_valid.numpy()}


@pytest.mark.parametrize("fusion", FUSIONS)
@pytest.mark.parametrize("valid", VALID)
def test_a_fusion_equals_the_loop(fusion, valid):
    module, window, frames = with_random_weights(fusion(ASYMMETRIC)), window_with(*valid), frames_of(FRAMES)
    arrays = [bev[0].double().numpy() for bev in frames]
    expected = FUSIONS[fusion](references.weights_of(module), arrays, arrays_of(window), ASYMMETRIC)
    assert_close(module(frames, window)[0], expected, 5e-5)  # the float32 errors of three frames add up


@pytest.mark.parametrize("fusion", FUSIONS)
@pytest.mark.parametrize("number", [float("nan"), float("inf"), 0.0])
def test_the_values_of_a_masked_frame_have_no_effect(fusion, number):
    module, window, frames = with_random_weights(fusion(ASYMMETRIC)), window_with(True, False, True), frames_of(FRAMES)
    expected = module(frames, window)
    frames[1] = torch.full_like(frames[1], number)
    window.past_T_now[1] = number
    assert torch.equal(module(frames, window), expected)


@pytest.mark.parametrize("fusion", FUSIONS)
def test_empty_slots_change_the_result_by_rounding_only(fusion):
    """With more frames, the convolution may add in another order."""
    module, frames = with_random_weights(fusion(ASYMMETRIC)), frames_of(FRAMES)
    alone = module(frames[:1], window_with(True))
    assert_close(module(frames, window_with(True, False, False)), alone.detach(), 1e-6)


@pytest.mark.parametrize("fusion", FUSIONS)
def test_every_frame_changes_the_result(fusion):
    module, window, frames = with_random_weights(fusion(ASYMMETRIC)), window_with(True, True, True), frames_of(FRAMES)
    whole = module(frames, window)
    for t in range(FRAMES):
        changed = [bev + 0.1 * (slot == t) for slot, bev in enumerate(frames)]
        assert not torch.allclose(module(changed, window), whole, atol=1e-4)


def moved_by(ego_T_past):
    """A window of two frames. ego_T_past: the past ego frame in the current ego frame."""
    window = window_with(True, True)
    window.past_T_now[1] = torch.tensor(np.linalg.inv(ego_T_past), dtype=torch.float32)
    return window


def test_a_feature_moves_opposite_to_the_ego():
    """Cells are 5 m along x and 6.25 m along y. The ego drove 10 m ahead and 6.25 m to the left."""
    past = torch.zeros(1, 32, 12, 8)
    past[0, :, 7, 3] = 1.0
    aligned = EgoAlignment(ASYMMETRIC.voxels)([past, past], moved_by(rigid(0, translation=(-10, -6.25, 0))))
    expected = torch.zeros(1, 32, 12, 8)
    expected[0, :, 5, 2] = 1.0
    torch.testing.assert_close(aligned[1], expected, rtol=0, atol=1e-5)
    assert aligned[0] is past, "the current frame is unchanged"


def test_a_feature_turns_opposite_to_the_ego():
    """The ego turned a quarter to the left: what was ahead of it, at (20, 0) m, is to its right, at (0, -20) m.

    The position is between cells. The features are linear in y, so bilinear sampling is exact there.
    """
    y_m = -35 + 6.25 * (torch.arange(8.0) + 0.5)
    past = y_m.expand(1, 32, 12, 8).contiguous()
    aligned = EgoAlignment(ASYMMETRIC.voxels)([past, past], moved_by(rigid(-np.pi / 2)))[1]
    for i, j in ((4, 3), (3, 4), (5, 2)):
        x_now_m, y_now_m = -20 + 5 * (i + 0.5), -35 + 6.25 * (j + 0.5)
        assert -20 < -y_now_m < 40  # the position in the past frame is (-y, x)
        torch.testing.assert_close(aligned[0, :, i, j], torch.full((32,), x_now_m), rtol=1e-4, atol=1e-3)


def test_a_cell_that_was_out_of_range_is_zero():
    past = torch.ones(1, 32, 12, 8)
    aligned = EgoAlignment(ASYMMETRIC.voxels)([past, past], moved_by(rigid(0, translation=(-30, 0, 0))))[1]
    assert aligned[0, :, :6].eq(1).all(), "from -20 to 10 m: the features of the past frame 30 m further ahead"
    assert aligned[0, :, 6:].eq(0).all()


def test_the_oldest_frame_uses_itself_as_its_past():
    attention, (bev, _) = with_random_weights(TemporalSelfAttention(ASYMMETRIC)), frames_of(2)
    assert torch.equal(attention([bev], window_with(True)), attention.attend(bev, bev))


def test_the_initial_offsets_are_the_same_for_both_maps():
    """BEVFormer's initial offsets: 4 heads at right angles to each other, points 1 to 4 cells away."""
    offsets = TemporalSelfAttention(ASYMMETRIC).attention.offsets.bias.detach().reshape(2, 4, 4, 2)
    ways = torch.tensor([(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)])
    expected = ways[:, None] * torch.arange(1.0, 5.0)[:, None]
    torch.testing.assert_close(offsets, expected.expand(2, 4, 4, 2), rtol=0, atol=1e-6)
