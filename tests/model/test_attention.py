"""Deformable attention in both spaces, and self-attention, against loops over the equations."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from torch import nn

from duospacenet.model import multi_scale_deformable_attention
from duospacenet.model.attention import BEVAttention, DeformableAttention, PVAttention, SelfAttention
from duospacenet.model.config import VoxelGrid
from tests.helpers import references
from tests.helpers.model_inputs import (
    ASYMMETRIC,
    assert_close,
    bev_features,
    normal,
    pinhole,
    pv_features,
    random_poses,
    random_window,
    rigid,
    ring_of_cameras,
    with_random_weights,
)

SHAPES = [(5, 7), (3, 4), (2, 2), (1, 3)]
QUERIES = 24


def attend_by_function_and_loop(shapes, locations, num_heads=2, head_channels=3, dtype=torch.float64):
    """The results of the function and of the loop for random values and weights."""
    batch, num_queries, _, num_levels, num_points, _ = locations.shape
    value = normal(batch, sum(h * w for h, w in shapes), num_heads, head_channels, seed=1).to(dtype)
    weights = normal(batch, num_queries, num_heads, num_levels, num_points, seed=2).to(dtype)
    fast = multi_scale_deformable_attention(value, torch.tensor(shapes), locations.to(dtype), weights)
    slow = references.multi_scale_deformable_attention(
        value.double().numpy(), shapes, locations.to(dtype).double().numpy(), weights.double().numpy()
    )
    return fast, slow


# --- The function -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("num_levels", "num_points", "num_heads", "head_channels"),
    [(1, 1, 1, 4), (1, 16, 4, 2), (2, 8, 8, 3), (4, 4, 2, 5)],
)
def test_sampling_equals_the_loop(num_levels, num_points, num_heads, head_channels):
    generator = torch.Generator().manual_seed(0)
    shape = (2, QUERIES, num_heads, num_levels, num_points, 2)
    locations = torch.rand(*shape, generator=generator, dtype=torch.float64) * 1.8 - 0.4  # a quarter outside
    fast, slow = attend_by_function_and_loop(SHAPES[:num_levels], locations, num_heads, head_channels)
    assert_close(fast, slow, 1e-12)


@pytest.mark.parametrize("shape", [(5, 7), (2, 2), (1, 3), (1, 1)])
def test_sampling_equals_the_loop_on_borders_and_cell_centres(shape):
    along = [
        [0.0, 1.0, 0.5, 0.5 / n, 1 - 0.5 / n, -0.5 / n, 1 + 0.5 / n, -1e-9, 1 + 1e-9, 1.5 / n, -1.0, 2.0, -30.0]
        for n in shape
    ]
    places = torch.tensor([(x, y) for y, x in product(*along)], dtype=torch.float64)
    locations = places.reshape(1, -1, 1, 1, 1, 2).expand(1, -1, 2, 1, 1, 2)
    fast, slow = attend_by_function_and_loop([shape], locations)
    assert_close(fast, slow, 1e-12)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("far", [(1e6, 0.5), (-1e6, 0.5), (0.5, 1e6), (0.5, -1e6), (1e6, -1e6), (1e30, 0.5)])
def test_samples_far_outside_are_zero(far, dtype):
    locations = torch.tensor(far, dtype=dtype).expand(1, 3, 2, 4, 2, 2)
    value = torch.ones(1, sum(h * w for h, w in SHAPES), 2, 3, dtype=dtype)
    weights = torch.ones(1, 3, 2, 4, 2, dtype=dtype)
    attended = multi_scale_deformable_attention(value, torch.tensor(SHAPES), locations, weights)
    assert attended.eq(0).all()


@pytest.mark.parametrize(
    ("x", "y", "expected"),
    [
        (0.5, 0.5, 2.5),  # between all four
        (0.25, 0.25, 1.0),  # the centre of the first pixel
        (0.75, 0.25, 2.0),  # x runs along the width
        (0.25, 0.75, 3.0),
        (0.0, 0.0, 0.25),  # a corner: three quarters of it are outside
        (1.0, 1.0, 1.0),
        (0.0, 0.25, 0.5),  # a border: half outside
        (0.375, 0.25, 1.25),
        (-0.25, 0.25, 0.0),  # a whole pixel from the first centre
    ],
)
def test_sampling_is_bilinear_between_pixel_centres(x, y, expected):
    value = torch.tensor([1.0, 2.0, 3.0, 4.0]).reshape(1, 4, 1, 1)
    locations = torch.tensor([x, y]).reshape(1, 1, 1, 1, 1, 2)
    attended = multi_scale_deformable_attention(value, torch.tensor([(2, 2)]), locations, torch.ones(1, 1, 1, 1, 1))
    assert attended.item() == expected


# --- The layers ---------------------------------------------------------------------------------------------------


def test_offsets_are_predicted_in_cells_and_weights_add_up_to_one_over_levels_and_points():
    attention = with_random_weights(DeformableAttention(8, 2, len(SHAPES), 3))
    query = normal(5, 8, seed=1)
    offsets, weights = attention.offsets_and_weights(query[None])
    assert (offsets.shape, weights.shape) == ((1, 5, 2, 4, 3, 2), (1, 5, 2, 4, 3))
    torch.testing.assert_close(weights.sum(dim=(3, 4)), torch.ones(1, 5, 2))
    cells = attention.offsets(query).reshape(5, 2, 4, 3, 2)
    logits = attention.weights(query).reshape(5, 2, 4, 3)
    for q, head, level, point in np.ndindex(5, 2, 4, 3):
        torch.testing.assert_close(offsets[0, q, head, level, point], cells[q, head, level, point])
        share = logits[q, head, level, point].exp() / logits[q, head].exp().sum()
        torch.testing.assert_close(weights[0, q, head, level, point], share)


def test_the_initial_offsets_have_a_direction_per_head_and_grow_by_one_cell_per_point():
    """Deformable-DETR's initial offsets: 8 heads at 45 degrees to each other, on the sides of a square."""
    attention = DeformableAttention(16, 8, 2, 3)
    offsets = attention.offsets(normal(5, 16, seed=0)).reshape(5, 8, 2, 3, 2)
    ways = torch.tensor([(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1)], dtype=torch.float32)
    expected = ways[:, None, None] * torch.tensor([1.0, 2.0, 3.0])[:, None]
    torch.testing.assert_close(offsets, expected.expand(5, 8, 2, 3, 2))
    assert attention.weights(normal(5, 16, seed=0)).eq(0).all()


# --- In BEV -------------------------------------------------------------------------------------------------------


def test_bev_attention_equals_the_loop_frame_by_frame_on_an_asymmetric_grid():
    attention = with_random_weights(BEVAttention(ASYMMETRIC))
    query = normal(2, QUERIES, 32, seed=1)
    poses = torch.stack([random_poses(ASYMMETRIC, QUERIES, seed=t) for t in (3, 4)])
    frames = [bev_features(ASYMMETRIC, seed=t) for t in range(2)]

    window = random_window(ASYMMETRIC, 2)
    attended = attention(query, poses, [attention.project_values(bev) for bev in frames], window)

    weights = references.weights_of(attention)
    for t, bev in enumerate(frames):
        expected = references.bev_attention(
            weights, query[t].double().numpy(), poses[t].double().numpy(), bev[0].double().numpy(), ASYMMETRIC
        )
        assert_close(attended[t], expected)


def that_copies_the_reference_point(config):
    """BEV attention that returns the feature at the reference point unchanged."""
    attention = BEVAttention(config)
    with torch.no_grad():
        for projection in (attention.deformable.value, attention.deformable.output):
            projection.weight.copy_(torch.eye(config.channels).reshape(projection.weight.shape))
            projection.bias.zero_()
        attention.deformable.offsets.bias.zero_()
    return attention


def attend_at_poses(attention, poses, bev):
    """The result of `attention` at the poses (Q, 10) of a single frame."""
    window = random_window(ASYMMETRIC, 1)
    with torch.no_grad():
        return attention(torch.zeros(1, len(poses), 32), poses[None], [attention.project_values(bev)], window)[0]


@pytest.mark.parametrize("cell", [(0, 0), (2, 5), (5, 2), (11, 1), (6, 7)])
def test_a_feature_in_a_bev_cell_is_found_at_its_own_x_and_y_only(cell):
    """Cells are 5 m along x, from -20 m, and 6.25 m along y, from -35 m."""
    feature = torch.arange(1.0, 33.0)
    bev = torch.zeros(1, 32, 12, 8)
    bev[0, :, cell[0], cell[1]] = feature
    poses = torch.zeros(12 * 8, 10)
    for place, (i, j) in enumerate(np.ndindex(12, 8)):
        poses[place, :2] = torch.tensor([-20 + 5 * (i + 0.5), -35 + 6.25 * (j + 0.5)])

    attended = attend_at_poses(that_copies_the_reference_point(ASYMMETRIC), poses, bev).reshape(12, 8, 32)

    torch.testing.assert_close(attended[cell], feature)
    attended[cell] = 0
    assert attended.abs().max() < 1e-4


def test_a_bev_feature_on_a_square_grid_is_not_found_at_the_transposed_place():
    config = replace(ASYMMETRIC, voxels=VoxelGrid((16, 16, 4)))  # 6.4 m from -51.2 m, both ways
    bev = torch.zeros(1, 32, 16, 16)
    bev[0, :, 12, 3] = 1.0  # x = 28.8 m, y = -28.8 m
    poses = torch.zeros(2, 10)
    poses[:, :2] = torch.tensor([[28.8, -28.8], [-28.8, 28.8]])
    attended = attend_at_poses(that_copies_the_reference_point(config), poses, bev)
    torch.testing.assert_close(attended, torch.tensor([1.0, 0.0])[:, None].expand(2, 32))


def test_the_first_offset_runs_along_y_and_the_second_along_x():
    """As in Deformable-DETR, the first offset is along the width."""
    attention = that_copies_the_reference_point(ASYMMETRIC)
    with torch.no_grad():
        attention.deformable.offsets.bias.copy_(torch.tensor([2.0, -3.0]).repeat(4 * 4))
    bev = torch.zeros(1, 32, 12, 8)
    bev[0, :, 5 - 3, 4 + 2] = 1.0
    pose = torch.zeros(1, 10)
    pose[0, :2] = torch.tensor([-20 + 5 * 5.5, -35 + 6.25 * 4.5])  # the cell (5, 4)
    torch.testing.assert_close(attend_at_poses(attention, pose, bev), torch.ones(1, 32))


# --- In PV --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("lost", [(), (2,), (0, 1, 2, 3, 4)])
def test_pv_attention_equals_the_loop_frame_by_frame(lost):
    """Two frames, each with its own queries, poses, features and calibration; the second one loses cameras."""
    attention = with_random_weights(PVAttention(ASYMMETRIC))
    query = normal(2, QUERIES, 32, seed=1)
    poses = torch.stack([random_poses(ASYMMETRIC, QUERIES, seed=t) for t in (4, 5)])
    image_T_ego = torch.stack([ring_of_cameras(6, 160, 64, seed=t) for t in range(2)])
    frames = [pv_features(ASYMMETRIC, seed=t) for t in range(2)]
    camera_valid = torch.tensor([[True] * 6, [camera not in lost for camera in range(6)]])

    window = random_window(ASYMMETRIC, 2)._replace(image_T_ego=image_T_ego, camera_valid=camera_valid)
    attended = attention(query, poses, [attention.project_values(pv) for pv in frames], window)

    weights = references.weights_of(attention)
    for t, pv in enumerate(frames):
        expected = references.pv_attention(
            weights,
            query[t].double().numpy(),
            poses[t].double().numpy(),
            [level.double().numpy() for level in pv],
            image_T_ego[t].double().numpy(),
            camera_valid[t].numpy(),
            ASYMMETRIC,
        )
        assert_close(attended[t], expected)


def test_the_random_poses_are_visible_in_no_camera_in_one_and_in_two():
    """The test above needs all three cases."""
    image_T_ego, poses = ring_of_cameras(6, 160, 64).double().numpy(), random_poses(ASYMMETRIC, QUERIES, seed=4)
    places = [[references.project(p[:3].double().numpy(), m, 160, 64) for m in image_T_ego] for p in poses]
    assert {sum(place is not None for place in views) for views in places} == {0, 1, 2}


def test_the_result_is_zero_for_a_query_behind_the_camera_too_near_or_beside_the_image():
    """A camera 1.5 m above the ground looks ahead. With a focal length of 80 px, 160 px cover 45° to each side."""
    attention = with_random_weights(PVAttention(ASYMMETRIC))
    image_T_ego = torch.tensor(pinhole(80, (80, 32), rigid(0, translation=(0, 0, 1.5))), dtype=torch.float32)[None]
    poses = torch.zeros(1, 5, 10)
    poses[0, :, :3] = torch.tensor([(10, 0, 1.5), (-10, 0, 1.5), (0.09, 0, 1.5), (10, 10.1, 1.5), (10, 0, 5.6)])
    values = [attention.project_values([level[:1] for level in pv_features(ASYMMETRIC)])]
    window = random_window(ASYMMETRIC, 1)._replace(image_T_ego=image_T_ego[None], camera_valid=torch.tensor([[True]]))
    attended = attention(normal(1, 5, 32, seed=1), poses, values, window)[0]
    assert torch.equal(attended[1:], torch.zeros(4, 32))
    assert attended[0].abs().min() > 0


# --- Self-attention -----------------------------------------------------------------------------------------------


@pytest.fixture
def self_attention():
    return with_random_weights(SelfAttention(24, 4)).double()


def test_self_attention_equals_the_loop(self_attention):
    z = normal(7, 24, seed=1).double()
    expected = references.self_attention(references.weights_of(self_attention), z.numpy(), 4)
    assert_close(self_attention(z), expected, 1e-12)


def test_self_attention_equals_torch_multihead_attention(self_attention):
    other = nn.MultiheadAttention(24, 4, batch_first=True).double()
    projection = self_attention.query_key_value
    with torch.no_grad():
        other.in_proj_weight.copy_(projection.weight)
        other.in_proj_bias.copy_(projection.bias)
        other.out_proj.weight.copy_(self_attention.output.weight)
        other.out_proj.bias.copy_(self_attention.output.bias)
    z = normal(7, 24, seed=1).double()
    assert_close(self_attention(z), other(z[None], z[None], z[None])[0][0].detach(), 1e-12)


def test_self_attention_equals_scaled_dot_product_attention(self_attention):
    z = normal(7, 24, seed=1).double()
    heads = self_attention.query_key_value(z).reshape(7, 3, 4, 6)
    attended = F.scaled_dot_product_attention(*(heads[:, i].transpose(0, 1) for i in range(3)))
    expected = self_attention.output(attended.transpose(0, 1).reshape(7, 24))
    assert_close(self_attention(z), expected.detach(), 1e-12)
