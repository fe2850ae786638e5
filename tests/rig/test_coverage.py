"""Coverage: compared with loops and with cases worked by hand."""

from dataclasses import replace

import numpy as np
import pytest

from duospacenet.rig.coverage import compute_coverage, nearest_ground_m, preprocessed_camera
from duospacenet.runtime.bundle.manifest import PerceptionRange
from tests.helpers.rigs import UPPER_HALF_CROP, level_camera

TINY = PerceptionRange(size=(4, 4, 2), lower_m=(-4.0, -4.0, -1.0), upper_m=(4.0, 4.0, 1.0))
LONG = PerceptionRange(size=(8, 4, 1), lower_m=(-2.0, -6.0, -1.0), upper_m=(14.0, 2.0, 1.0))
ORIGIN = (0.0, 0.0, 0.0)


def test_a_camera_at_the_origin_sees_seven_voxels_of_a_tiny_grid():
    """Centres at ±1 and ±3 m, heights ±0.5 m; u = 80 - 80 y / x in [0, 160), v = 40 - 80 z / x in [0, 80).

    x = 1: y = 1 (u = 0, seen) and y = -1 (u = 160, not); z = 0.5 (v = 0, seen) and z = -0.5 (v = 80, not): 1 voxel.
    x = 3: y = 3, 1, -1 and both heights: 6 voxels.
    """
    coverage = compute_coverage({"FRONT": level_camera(0, ORIGIN)}, TINY, None)
    seen = {tuple(index) for index in np.argwhere(coverage.voxels["FRONT"]).tolist()}
    assert seen == {(2, 2, 1)} | {(3, j, k) for j in (1, 2, 3) for k in (0, 1)}
    assert coverage.voxel_share("FRONT") == coverage.exclusive_share("FRONT") == 7 / 32


def test_coverage_equals_a_plain_loop_on_a_grid_that_is_longer_than_wide():
    camera = level_camera(-30, (0.5, -0.25, 1.0))
    expected = np.zeros((8, 4, 1), bool)
    ground = np.zeros((8, 4), bool)
    for i in range(8):
        for j in range(4):
            for height_m, mask in ((0.0, expected[:, :, 0]), (0.0, ground)):
                point = np.array([-1.0 + 2 * i, -5.0 + 2 * j, height_m, 1.0])
                right, down, forward, _ = camera.camera_T_ego @ point
                if forward > 0.1:
                    u, v = 80 + 80 * right / forward, 40 + 80 * down / forward
                    mask[i, j] = 0 <= u < 160 and 0 <= v < 80
    coverage = compute_coverage({"a": camera}, LONG, None)
    assert np.array_equal(coverage.voxels["a"], expected)
    assert np.array_equal(coverage.ground["a"], ground)
    assert 0 < ground.sum() < 32


def test_90_degree_cameras_that_look_90_degrees_apart_have_no_overlap():
    coverage = compute_coverage({"FRONT": level_camera(0, ORIGIN), "LEFT": level_camera(90, ORIGIN)}, TINY, None)
    assert coverage.overlap("FRONT", "LEFT") == 0
    assert coverage.voxels["LEFT"].sum() == 7


def test_shares_and_overlap_of_cameras_with_the_same_pose():
    one, half = level_camera(0, ORIGIN), level_camera(0, ORIGIN, width_px=80)  # `half` sees the left half: y > 0
    coverage = compute_coverage({"one": one, "half": half}, TINY, None)
    assert coverage.voxels["half"].sum() == 5  # y = 1 and y = 3 at x = 3, and the voxel at x = 1
    assert coverage.overlap("one", "half") == coverage.overlap("half", "one") == 5 / 7
    assert coverage.exclusive_share("one") == 2 / 32
    assert coverage.exclusive_share("half") == 0
    assert coverage.shares_by_count() == {"0": 25 / 32, "1": 2 / 32, "2": 5 / 32, "3+": 0.0}
    three = compute_coverage(dict.fromkeys("abc", one), TINY, None)
    assert three.shares_by_count()["3+"] == 7 / 32


def test_cropped_parts_of_the_image_are_not_visible():
    camera = level_camera(0, ORIGIN)  # halved to 80x40 px, then the upper 20 rows are cropped: z > 0 is not visible
    seen = compute_coverage({"FRONT": camera}, TINY, UPPER_HALF_CROP).voxels["FRONT"]
    assert {tuple(index) for index in np.argwhere(seen).tolist()} == {(3, j, 0) for j in (1, 2, 3)}
    network_camera = preprocessed_camera(camera, UPPER_HALF_CROP)
    assert network_camera.intrinsics_px.tolist() == [[40, 0, 40], [0, 40, 0], [0, 0, 1]]
    assert (network_camera.width_px, network_camera.height_px) == (80, 20)


def test_the_nearest_ground_is_at_the_lower_border_of_the_image():
    camera = level_camera(0, (1.0, 2.0, 1.5))  # the ray through the lower border falls 0.5 m per metre: 1.5 / 0.5
    assert nearest_ground_m(camera, None) == pytest.approx(3.0)


def test_the_nearest_ground_is_at_0_m_below_a_downward_camera_and_nan_for_an_upward_one():
    down, up = level_camera(0, (1.0, 2.0, 1.5)), level_camera(0, (1.0, 2.0, 1.5))
    down.camera_T_ego[:3] = [[0, -1, 0, 2], [-1, 0, 0, 1], [0, 0, -1, 1.5]]
    up.camera_T_ego[:3] = [[0, -1, 0, 2], [1, 0, 0, -1], [0, 0, 1, -1.5]]
    assert nearest_ground_m(down, None) == 0
    assert np.isnan(nearest_ground_m(up, None))


def test_a_camera_far_from_the_grid_sees_no_voxel():
    camera = level_camera(0, (1000.0, 0, 1.5))
    coverage = compute_coverage({"far": camera, "same": replace(camera)}, TINY, None)
    assert coverage.voxel_share("far") == coverage.overlap("far", "same") == 0
