"""Clipping polygons, by hand-worked cases."""

import numpy as np

from duospacenet.synthetic.polygon_clipping import clip_at_plane, clip_polygons

SQUARE = np.array([[0.0, 0.0, 1.0], [2.0, 0.0, 1.0], [2.0, 2.0, 1.0], [0.0, 2.0, 1.0]])
RIGHT_OF_ONE = np.array([1.0, 0.0, 0.0, -1.0])  # x >= 1
BELOW_ONE = np.array([0.0, -1.0, 0.0, 1.0])  # y <= 1


def test_a_square_is_clipped_to_its_right_half():
    points, counts = clip_at_plane(SQUARE, np.array([4]), RIGHT_OF_ONE)
    assert counts.tolist() == [4]
    assert points.tolist() == [[1, 0, 1], [2, 0, 1], [2, 2, 1], [1, 2, 1]]


def test_a_corner_that_is_cut_off_gives_a_polygon_of_five_points():
    plane = np.array([-1.0, -1.0, 0.0, 3.0])  # x + y <= 3
    points, counts = clip_at_plane(SQUARE, np.array([4]), plane)
    assert counts.tolist() == [5]
    assert points.tolist() == [[0, 0, 1], [2, 0, 1], [2, 1, 1], [1, 2, 1], [0, 2, 1]]


def test_a_polygon_outside_of_the_plane_has_no_points_and_does_not_disturb_the_next_one():
    points, counts = clip_at_plane(np.concatenate([SQUARE - [5, 0, 0], SQUARE]), np.array([4, 4]), RIGHT_OF_ONE)
    assert counts.tolist() == [0, 4]
    assert points.tolist() == [[1, 0, 1], [2, 0, 1], [2, 2, 1], [1, 2, 1]]


def test_polygons_inside_outside_and_across_planes_are_told_apart():
    inside, outside, across = SQUARE * 0.2 + [1.2, 0, 0], SQUARE - [5, 0, 0], SQUARE
    points = np.concatenate([across, outside, inside])
    clipped = clip_polygons(points, np.array([4, 4, 4]), np.stack([RIGHT_OF_ONE, BELOW_ONE]))
    assert clipped.sources.tolist() == [0, 2]
    first, second = (
        clipped.points[start : start + count] for start, count in zip(clipped.starts, clipped.counts, strict=True)
    )
    assert sorted(first.tolist()) == [[1, 0, 1], [1, 1, 1], [2, 0, 1], [2, 1, 1]]
    np.testing.assert_array_equal(second, inside)
