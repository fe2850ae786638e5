"""What cameras see of the space around them, against loops and cases worked by hand."""

from dataclasses import replace

import numpy as np
import pytest

from duospacenet.rig.coverage import blind_sectors, cover, nearest_ground_m, through
from duospacenet.rig.formatting import describe_sectors
from duospacenet.runtime.bundle.manifest import PerceptionRange
from tests.helpers.rigs import UPPER_HALF_CUT, level_camera

TINY = PerceptionRange(size=(4, 4, 2), lower_m=(-4.0, -4.0, -1.0), upper_m=(4.0, 4.0, 1.0))
LONG = PerceptionRange(size=(8, 4, 1), lower_m=(-2.0, -6.0, -1.0), upper_m=(14.0, 2.0, 1.0))
ORIGIN = (0.0, 0.0, 0.0)


def test_a_camera_at_the_origin_sees_seven_voxels_of_a_tiny_grid():
    """Centres at ±1 and ±3 m, heights ±0.5 m; u = 80 - 80 y / x in [0, 160), v = 40 - 80 z / x in [0, 80).

    x = 1: y = 1 (u = 0, seen) and y = -1 (u = 160, not); z = 0.5 (v = 0, seen) and z = -0.5 (v = 80, not): 1 voxel.
    x = 3: y = 3, 1, -1 and both heights: 6 voxels.
    """
    coverage = cover({"FRONT": level_camera(0, ORIGIN)}, TINY, None)
    seen = {tuple(index) for index in np.argwhere(coverage.voxels["FRONT"]).tolist()}
    assert seen == {(2, 2, 1)} | {(3, j, k) for j in (1, 2, 3) for k in (0, 1)}
    assert coverage.share("FRONT") == coverage.share_alone("FRONT") == 7 / 32


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
    coverage = cover({"a": camera}, LONG, None)
    assert np.array_equal(coverage.voxels["a"], expected)
    assert np.array_equal(coverage.ground["a"], ground)
    assert 0 < ground.sum() < 32


def test_cameras_of_90_degrees_that_look_90_degrees_apart_share_nothing():
    coverage = cover({"FRONT": level_camera(0, ORIGIN), "LEFT": level_camera(90, ORIGIN)}, TINY, None)
    assert coverage.overlap("FRONT", "LEFT") == 0
    assert coverage.voxels["LEFT"].sum() == 7


def test_shares_by_count_alone_and_overlap_of_a_camera_beside_itself():
    one, half = level_camera(0, ORIGIN), level_camera(0, ORIGIN, width_px=80)  # the half sees the left: y > 0
    coverage = cover({"one": one, "half": half}, TINY, None)
    assert coverage.voxels["half"].sum() == 5  # y = 1, 3 of x = 3, and the near one
    assert coverage.overlap("one", "half") == coverage.overlap("half", "one") == 5 / 7
    assert coverage.share_alone("one") == 2 / 32
    assert coverage.share_alone("half") == 0
    assert coverage.shares_by_count() == {"0": 25 / 32, "1": 2 / 32, "2": 5 / 32, "3+": 0.0}
    three = cover(dict.fromkeys("abc", one), TINY, None)
    assert three.shares_by_count()["3+"] == 7 / 32


def test_what_the_network_cuts_off_is_not_seen():
    camera = level_camera(0, ORIGIN)  # 160x80 is halved to 80x40, and the upper 20 rows are cut: z > 0 is lost
    seen = cover({"FRONT": camera}, TINY, UPPER_HALF_CUT).voxels["FRONT"]
    assert {tuple(index) for index in np.argwhere(seen).tolist()} == {(3, j, 0) for j in (1, 2, 3)}
    through_network = through(camera, UPPER_HALF_CUT)
    assert through_network.intrinsics_px.tolist() == [[40, 0, 40], [0, 40, 0], [0, 0, 1]]
    assert (through_network.width_px, through_network.height_px) == (80, 20)


def test_the_ground_begins_where_the_lower_border_meets_it():
    camera = level_camera(0, (1.0, 2.0, 1.5))  # the lower border looks down by half of forward: 1.5 / 0.5
    assert nearest_ground_m(camera, None) == pytest.approx(3.0)


def test_a_camera_that_sees_the_point_below_it_begins_at_zero_and_one_that_looks_up_never():
    down, up = level_camera(0, (1.0, 2.0, 1.5)), level_camera(0, (1.0, 2.0, 1.5))
    down.camera_T_ego[:3] = [[0, -1, 0, 2], [-1, 0, 0, 1], [0, 0, -1, 1.5]]
    up.camera_T_ego[:3] = [[0, -1, 0, 2], [1, 0, 0, -1], [0, 0, 1, -1.5]]
    assert nearest_ground_m(down, None) == 0
    assert np.isnan(nearest_ground_m(up, None))


def test_one_camera_leaves_270_degrees_blind_from_its_left_border_round_to_its_right():
    grid = replace_size(TINY, 40.0)
    assert blind_sectors({"FRONT": level_camera(0, (0, 0, 1.5))}, grid, None) == [(45, 315)]
    assert blind_sectors({"LEFT": level_camera(90, (0, 0, 1.5))}, grid, None) == [(135, 405)]
    around = {str(azimuth): level_camera(azimuth, (0, 0, 1.5)) for azimuth in (0, 90, 180, 270)}
    assert blind_sectors(around, grid, None) == []
    assert blind_sectors({}, grid, None) == [(0, 360)]


def test_blind_sectors_lie_on_the_side_where_nobody_looks():
    cameras = {str(azimuth): level_camera(azimuth, (0, 0, 1.5)) for azimuth in (0, 90, 180)}
    assert blind_sectors(cameras, replace_size(TINY, 40.0), None) == [(225, 315)]


def test_two_blind_sectors_keep_their_own_ends_also_over_straight_ahead():
    cameras = {str(azimuth): level_camera(azimuth, (0, 0, 1.5)) for azimuth in (90, -90)}
    assert blind_sectors(cameras, replace_size(TINY, 40.0), None) == [(135, 225), (315, 405)]


@pytest.mark.parametrize(("row_px", "sectors"), [(75.2, [(0, 360)]), (72.0, [])])
def test_a_direction_is_blind_if_less_than_half_of_its_ground_beyond_5_m_is_seen(row_px, sectors):
    """The ground begins where 80 * 1.5 / x rows are below the horizon: at 25 m, or at 15 m, of 40 (57 to a corner)."""
    lens = np.array([[80, 0, 80], [0, 80, row_px], [0, 0, 1]])
    around = {str(azimuth): level_camera(azimuth, (0, 0, 1.5), intrinsics_px=lens) for azimuth in (0, 90, 180, 270)}
    assert blind_sectors(around, replace_size(TINY, 40.0), None) == sectors
    words = describe_sectors(blind_sectors(around, replace_size(TINY, 40.0), None))
    assert ("less than half" if sectors else "at least half") + " of the ground beyond 5 m" in words


def test_a_range_that_lies_ahead_only_is_not_blind_behind():
    ahead = TINY.model_copy(update={"lower_m": (0.0, -40.0, -1.0), "upper_m": (40.0, 40.0, 1.0)})
    assert blind_sectors({"FRONT": level_camera(0, (0, 0, 1.5))}, ahead, None) == [(45, 90), (270, 315)]
    assert blind_sectors({}, ahead, None) == [(270, 450)]


def replace_size(grid: PerceptionRange, range_m: float) -> PerceptionRange:
    return grid.model_copy(update={"lower_m": (-range_m, -range_m, -1.0), "upper_m": (range_m, range_m, 1.0)})


def test_a_camera_far_from_the_grid_sees_none_of_it():
    camera = level_camera(0, (1000.0, 0, 1.5))
    coverage = cover({"far": camera, "same": replace(camera)}, TINY, None)
    assert coverage.share("far") == coverage.overlap("far", "same") == 0
