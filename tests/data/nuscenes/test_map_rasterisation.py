"""Polygons and lines on a grid of cells, beside loops over the cells."""

from itertools import pairwise

import numpy as np
import pytest

from duospacenet.data.mask_grid import MaskGrid
from duospacenet.data.nuscenes.map_rasterisation import draw_lines, fill_polygons
from tests.helpers.map_files import rectangle

GRIDS = [(200, 200), (100, 100), (64, 64), (16, 16), (40, 70)]


def centres(grid):
    """The centres (X, Y, 2) [m] of the cells."""
    axes = [
        np.linspace(lower, upper, 2 * size + 1)[1::2]
        for lower, upper, size in zip(grid.lower_m, grid.upper_m, grid.size, strict=True)
    ]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)


def is_inside(point, ring) -> bool:
    """Whether a ray from the point to the right crosses the ring an odd number of times."""
    inside = False
    for (x0, y0), (x1, y1) in zip(ring, np.roll(ring, -1, axis=0), strict=True):
        if (y0 > point[1]) != (y1 > point[1]) and point[0] < x0 + (point[1] - y0) * (x1 - x0) / (y1 - y0):
            inside = not inside
    return inside


def distance_to_line(points, line):
    """The distance (...) of points (..., 2) to a line through points (k, 2)."""
    distances = []
    for start, end in pairwise(line):
        direction = end - start
        along = np.clip(((points - start) @ direction) / max(direction @ direction, 1e-12), 0, 1)
        distances.append(np.linalg.norm(points - start - along[..., None] * direction, axis=-1))
    return np.min(distances, axis=0)


def random_ring(rng, centre, radius_m):
    angles = (np.arange(9) + rng.uniform(-0.4, 0.4, 9)) * 2 * np.pi / 9  # so that the smaller ring is in the larger
    return centre + rng.uniform(0.3, 1.0, (9, 1)) * radius_m * np.stack([np.cos(angles), np.sin(angles)], axis=1)


@pytest.mark.parametrize("size", GRIDS)
def test_a_cell_is_filled_if_its_centre_is_in_a_polygon_and_in_no_hole_of_it(size):
    rng = np.random.default_rng(sum(size))
    grid = MaskGrid(size)
    polygons = []
    for _ in range(4):
        centre = rng.uniform(-45, 45, 2)
        polygons.append([random_ring(rng, centre, 40.0), random_ring(rng, centre, 8.0)])
    mask = fill_polygons(polygons, grid)
    wrong = 0
    for index in rng.integers(0, size, (1500, 2)):
        index = tuple(index)
        point = CENTRES[size][index]
        expected = any(is_inside(point, rings[0]) and not is_inside(point, rings[1]) for rings in polygons)
        if mask[index] != expected:
            edges = [np.vstack([ring, ring[:1]]) for rings in polygons for ring in rings]
            assert min(distance_to_line(point, edge) for edge in edges) < 0.15  # m; OpenCV rounds the edges outwards
            wrong += 1
    assert wrong < 15


CENTRES = {size: centres(MaskGrid(size)) for size in GRIDS}


def test_the_first_axis_is_forward_and_the_second_to_the_left():
    grid = MaskGrid((4, 4), (-20.0, -20.0), (20.0, 20.0))
    mask = fill_polygons([[np.array(rectangle(1, -19, 19, -11))]], grid)  # ahead, on the right
    assert mask.tolist() == [[False] * 4, [False] * 4, [True, False, False, False], [True, False, False, False]]


def test_a_hole_of_one_polygon_does_not_cut_another_one():
    grid = MaskGrid((8, 8), (0.0, 0.0), (8.0, 8.0))
    with_hole = [np.array(rectangle(0, 0, 8, 8)), np.array(rectangle(2, 2, 6, 6))]
    other = [np.array(rectangle(4, 4, 8, 8))]
    expected = np.ones((8, 8), bool)
    expected[2:6, 2:6] = False
    expected[4:6, 4:6] = True
    for polygons in ([with_hole, other], [other, with_hole]):
        np.testing.assert_array_equal(fill_polygons(polygons, grid), expected)


@pytest.mark.parametrize("size", GRIDS)
def test_a_line_covers_the_cells_near_it_without_gaps(size):
    rng = np.random.default_rng(sum(size))
    grid = MaskGrid(size)
    cell = grid.cell_m.max()
    line = np.cumsum(rng.uniform(-4, 14, (9, 2)), axis=0) - 45
    distances = distance_to_line(CENTRES[size], line)
    mask = draw_lines([line], grid)
    half_width = max(0.512, 0.5 * grid.cell_m.min())
    assert not mask[distances > half_width + 0.75 * cell].any()
    steps = np.linspace(line[:-1], line[1:], 100).reshape(-1, 2)
    steps = steps[(np.abs(steps) < 50).all(axis=1)]
    assert len(steps) > 300
    for step in steps:
        away = np.abs(CENTRES[size][mask] - step) / grid.cell_m
        assert away.max(axis=1).min() < 1  # a cell of the mask is at every place of the line, or right beside it


@pytest.mark.parametrize(("size", "cells"), [(400, 5), (200, 3), (100, 1), (64, 1), (16, 1)])
def test_a_line_of_two_cells_on_200_covers_three_as_opencv_draws_it_and_at_least_one_on_coarse_grids(size, cells):
    mask = draw_lines([np.array([[-60.0, 0.1], [60.0, 0.1]])], MaskGrid((size, size)))
    assert mask.sum(axis=1).tolist() == [cells] * size


def test_lines_and_polygons_far_beyond_the_grid_do_no_harm():
    grid = MaskGrid((200, 200))
    assert fill_polygons([[np.array(rectangle(-1e6, -1e6, 1e6, 1e6))]], grid).all()
    assert not fill_polygons([[np.array(rectangle(1e5, 1e5, 1e6, 1e6))]], grid).any()
    line = draw_lines([np.array([[-1e6, -1e6], [1e6, 1e6]])], grid)
    assert line[np.arange(200), np.arange(200)].all() and line.sum() < 1000
    assert not fill_polygons([], grid).any() and not draw_lines([], grid).any()
