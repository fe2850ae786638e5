"""Blind sectors, in cases worked by hand."""

import numpy as np
import pytest

from duospacenet.rig.blind_sectors import find_blind_sectors
from duospacenet.rig.formatting import describe_sectors
from duospacenet.runtime.bundle.manifest import PerceptionRange
from tests.helpers.rigs import level_camera

TINY = PerceptionRange(size=(4, 4, 2), lower_m=(-4.0, -4.0, -1.0), upper_m=(4.0, 4.0, 1.0))


def test_one_90_degree_camera_leaves_a_blind_sector_of_270_degrees():
    grid = with_range(TINY, 40.0)
    assert find_blind_sectors({"FRONT": level_camera(0, (0, 0, 1.5))}, grid, None) == [(45, 315)]
    assert find_blind_sectors({"LEFT": level_camera(90, (0, 0, 1.5))}, grid, None) == [(135, 405)]
    around = {str(azimuth): level_camera(azimuth, (0, 0, 1.5)) for azimuth in (0, 90, 180, 270)}
    assert find_blind_sectors(around, grid, None) == []
    assert find_blind_sectors({}, grid, None) == [(0, 360)]


def test_the_blind_sector_is_where_no_camera_looks():
    cameras = {str(azimuth): level_camera(azimuth, (0, 0, 1.5)) for azimuth in (0, 90, 180)}
    assert find_blind_sectors(cameras, with_range(TINY, 40.0), None) == [(225, 315)]


def test_a_blind_sector_across_straight_ahead_is_not_split():
    cameras = {str(azimuth): level_camera(azimuth, (0, 0, 1.5)) for azimuth in (90, -90)}
    assert find_blind_sectors(cameras, with_range(TINY, 40.0), None) == [(135, 225), (315, 405)]


@pytest.mark.parametrize(("row_px", "sectors"), [(75.2, [(0, 360)]), (72.0, [])])
def test_a_direction_is_blind_if_less_than_half_of_its_ground_beyond_5_m_is_visible(row_px, sectors):
    """The visible ground begins at 25 m or 15 m, of a range of 40 m (57 m to a corner).

    At distance x it is 80 * 1.5 / x rows below the horizon.
    """
    lens = np.array([[80, 0, 80], [0, 80, row_px], [0, 0, 1]])
    around = {str(azimuth): level_camera(azimuth, (0, 0, 1.5), intrinsics_px=lens) for azimuth in (0, 90, 180, 270)}
    assert find_blind_sectors(around, with_range(TINY, 40.0), None) == sectors
    text = describe_sectors(find_blind_sectors(around, with_range(TINY, 40.0), None))
    assert ("less than half" if sectors else "at least half") + " of the ground beyond 5 m" in text


def test_directions_outside_the_perception_range_are_not_blind():
    ahead = TINY.model_copy(update={"lower_m": (0.0, -40.0, -1.0), "upper_m": (40.0, 40.0, 1.0)})
    assert find_blind_sectors({"FRONT": level_camera(0, (0, 0, 1.5))}, ahead, None) == [(45, 90), (270, 315)]
    assert find_blind_sectors({}, ahead, None) == [(270, 450)]


def with_range(grid: PerceptionRange, range_m: float) -> PerceptionRange:
    """A grid over a square range of another size."""
    return grid.model_copy(update={"lower_m": (-range_m, -range_m, -1.0), "upper_m": (range_m, range_m, 1.0)})
