"""Projector and lifter against a loop over voxels, cameras and levels."""

import numpy as np
import pytest
import torch

from duospacenet.model.lifter import Lifter, Projector
from tests.helpers import references
from tests.helpers.model_inputs import (
    ASYMMETRIC,
    assert_close,
    normal,
    pinhole,
    pv_features,
    rigid,
    ring_of_cameras,
    with_random_weights,
)

# Level 0 of a 160×64 image has 20×8 cells. The next levels have half the size, rounded up.
LEVEL_SIZES = [(8, 20), (4, 10), (2, 5), (1, 3)]


def lift(lifter, pv, image_T_ego, camera_valid=None):
    """The voxels, computed in the dtype of `pv`. The locations of the voxels are float32 in any case."""
    camera_valid = torch.ones(len(image_T_ego), dtype=torch.bool) if camera_valid is None else camera_valid
    tables, dtype = Projector(ASYMMETRIC)(image_T_ego, camera_valid), pv[0].dtype
    assert tables.voxel_locations.dtype == torch.float32
    with torch.no_grad():
        levels = lifter.to(dtype).reduce(pv)
        return lifter(levels, tables._replace(voxel_locations=tables.voxel_locations.to(dtype)))


def lift_by_loop(lifter, pv, image_T_ego, camera_valid):
    return references.lift(
        references.weights_of(lifter)["reduction.weight"][:, :, 0, 0],
        [level.double().numpy() for level in pv],
        image_T_ego.double().numpy(),
        camera_valid.numpy(),
        ASYMMETRIC,
    )


@pytest.mark.parametrize("lost", [(), (3,), (0, 1, 2, 4, 5)])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_lifting_equals_the_loop(lost, dtype):
    lifter = with_random_weights(Lifter(ASYMMETRIC))
    pv = [level.to(dtype) for level in pv_features(ASYMMETRIC)]
    image_T_ego = ring_of_cameras(6, 160, 64)
    camera_valid = torch.tensor([camera not in lost for camera in range(6)])
    expected, counts = lift_by_loop(lifter, pv, image_T_ego, camera_valid)
    # Some voxels are visible in no camera, some in one and some in two.
    assert set(counts.flatten()) == ({0, 1, 2} if len(lost) < 5 else {0, 1})

    voxels = lift(lifter, pv, image_T_ego, camera_valid)

    assert_close(voxels[0], expected)
    assert voxels[0, :, torch.tensor(counts == 0)].eq(0).all()


def test_a_voxel_has_the_features_at_its_projected_centre():
    """By hand: voxel (6, 5, 2) is centred at x 12.5, y -0.625, z 2 m. A camera at the origin with 100 px
    of focal length shows it at u = 80 + 100 · 0.625 / 12.5 = 85, v = 32 - 100 · 2 / 12.5 = 16 px. In cells of
    8 px, counted between centres, that is column 10.125, row 1.5: 0.875 · 0.5 of row 1, column 10; and a quarter
    of it, because it is one of four levels.
    """
    lifter = with_random_weights(Lifter(ASYMMETRIC))
    pv = [torch.zeros(1, 32, *size) for size in LEVEL_SIZES]
    pv[0][0, 7, 1, 10] = 1.0
    image_T_ego = torch.tensor(pinhole(100, (80, 32), rigid(0)), dtype=torch.float32)[None]
    voxels = lift(lifter, pv, image_T_ego)
    assert voxels.shape == (1, 8, 4, 12, 8)
    expected = lifter.reduction.weight[:, 7, 0, 0].detach() * 0.875 * 0.5 / 4
    torch.testing.assert_close(voxels[0, :, 2, 6, 5], expected)


@pytest.mark.parametrize(
    ("yaw", "is_visible"),
    [
        (0.0, lambda x, y: x > 2 * abs(y)),
        (torch.pi / 2, lambda x, y: y > 2 * abs(x)),
        (torch.pi, lambda x, y: -x > 2 * abs(y)),
        (-torch.pi / 2, lambda x, y: -y > 2 * abs(x)),
    ],
)
def test_a_camera_fills_the_voxels_in_its_field_of_view(yaw, is_visible):
    """With a focal length of 160 px, an image 160 px wide covers |y| < x / 2. Every height is visible."""
    image_T_ego = torch.tensor(pinhole(160, (80, 32), rigid(yaw)), dtype=torch.float32)[None]
    image_T_ego[:, 1] = 32 * image_T_ego[:, 2]  # projects every height to the middle row
    voxels = lift(
        with_random_weights(Lifter(ASYMMETRIC)), [torch.ones(1, 32, *size) for size in LEVEL_SIZES], image_T_ego
    )
    filled = voxels[0].abs().sum(dim=0) > 0
    for i in range(12):
        for j in range(8):
            expected = is_visible(-20 + 5 * (i + 0.5), -35 + 6.25 * (j + 0.5))
            assert filled[:, i, j].eq(expected).all(), (i, j)


def test_cameras_with_the_same_view_are_averaged_not_summed():
    lifter = with_random_weights(Lifter(ASYMMETRIC))
    image_T_ego = ring_of_cameras(1, 160, 64)
    pv = [level[:1] for level in pv_features(ASYMMETRIC)]
    once = lift(lifter, pv, image_T_ego)
    thrice = lift(lifter, [level.expand(3, -1, -1, -1) for level in pv], image_T_ego.expand(3, -1, -1))
    assert_close(thrice, once, 1e-6)


def test_the_reduction_of_the_channels_commutes_with_the_sampling():
    """So the reduction can come first, and fewer channels are sampled."""
    lifter = with_random_weights(Lifter(ASYMMETRIC))
    pv = pv_features(ASYMMETRIC)
    image_T_ego = ring_of_cameras(6, 160, 64)
    whole = Lifter(ASYMMETRIC)
    whole.reduction = torch.nn.Identity()
    with torch.no_grad():
        after = torch.einsum("oc,bczxy->bozxy", lifter.reduction.weight[:, :, 0, 0], lift(whole, pv, image_T_ego))
    assert_close(lift(lifter, pv, image_T_ego), after)


@pytest.mark.parametrize("broken", [0.0, float("nan"), float("inf"), -float("inf"), 1e38])
def test_with_a_degenerate_projection_all_voxels_are_zero_and_not_nan(broken):
    image_T_ego = torch.full((6, 3, 4), broken)
    tables = Projector(ASYMMETRIC)(image_T_ego, torch.ones(6, dtype=torch.bool))
    assert all(table.isfinite().all() for table in tables)
    voxels = lift(with_random_weights(Lifter(ASYMMETRIC)), pv_features(ASYMMETRIC), image_T_ego)
    assert voxels.isfinite().all()
    if broken != 1e38:
        assert voxels.eq(0).all()


def test_the_calibration_of_a_lost_camera_has_no_effect():
    image_T_ego = ring_of_cameras(6, 160, 64)
    camera_valid = torch.tensor([True, True, False, True, True, True])
    tables = Projector(ASYMMETRIC)(image_T_ego, camera_valid)
    image_T_ego[2] = float("nan")
    for table, other in zip(tables, Projector(ASYMMETRIC)(image_T_ego, camera_valid), strict=True):
        assert torch.equal(table, other)


def test_voxels_are_zero_if_all_cameras_are_lost():
    camera_valid = torch.zeros(6, dtype=torch.bool)
    voxels = lift(
        with_random_weights(Lifter(ASYMMETRIC)), pv_features(ASYMMETRIC), ring_of_cameras(6, 160, 64), camera_valid
    )
    assert torch.equal(voxels, torch.zeros(1, 8, 4, 12, 8))


def test_a_camera_does_not_change_voxels_outside_its_field_of_view():
    ahead, behind = pinhole(100, (80, 32), rigid(0)), pinhole(100, (80, 32), rigid(torch.pi))
    lifter = with_random_weights(Lifter(ASYMMETRIC))
    pv = [normal(2, 32, *size, seed=5) for size in LEVEL_SIZES]
    both = lift(lifter, pv, torch.tensor(np.stack((ahead, behind)), dtype=torch.float32))
    alone = lift(lifter, [level[:1] for level in pv], torch.tensor(ahead[None], dtype=torch.float32))
    assert_close(both[..., 4:, :], alone[..., 4:, :], 1e-6)  # x > 0
    assert alone[..., :4, :].eq(0).all()
    assert both[..., :4, :].ne(0).any()
