"""The coverage map: positions of cells, fields of view and names, worked by hand."""

import numpy as np

from duospacenet.drawing.coverage_map import (
    COUNT_COLOURS,
    SIZE_PX,
    GroundCoverage,
    Wedge,
    draw_counts,
    draw_coverage_map,
)


def test_a_cell_ahead_on_the_left_is_at_the_upper_left_of_the_map():
    count = np.zeros((4, 2), int)  # x in [-4, 4] by 2 m, y in [-1, 3] by 2 m
    count[3, 1] = 2  # x in [2, 4], y in [1, 3]
    picture = draw_counts(GroundCoverage(count, (-4.0, -1.0), (4.0, 3.0)), 4.0, 80)  # 10 px per metre
    is_two = (picture == COUNT_COLOURS["2"]).all(axis=2)
    rows, columns = np.nonzero(is_two)
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (0, 19, 10, 29)
    assert is_two.sum() == 400
    assert (picture == COUNT_COLOURS["0"]).all(axis=2).sum() == 80 * 40 - 400  # the grid ends at y = -1 and y = 3


def test_more_than_three_cameras_have_the_colour_of_three():
    picture = draw_counts(GroundCoverage(np.array([[1, 3], [0, 7]]), (-1.0, -1.0), (1.0, 1.0)), 1.0, 2)
    # Row 0 is ahead, the cells [1, :]. Column 0 is left, the cells [:, 1].
    expected = [[COUNT_COLOURS["3+"], COUNT_COLOURS["0"]], [COUNT_COLOURS["3+"], COUNT_COLOURS["1"]]]
    assert picture.tolist() == [[list(colour) for colour in row] for row in expected]


def test_the_wedge_of_a_camera_that_looks_left_is_on_the_left():
    wedges = [Wedge("x", np.zeros(2), *np.radians([135, 90, 45]))]
    ground = GroundCoverage(np.zeros((2, 2), int), (-50.0, -50.0), (50.0, 50.0))
    colour = np.array([255, 165, 64])
    picture = draw_coverage_map(ground, wedges, [])[:SIZE_PX]
    is_wedge = (np.abs(picture.astype(int) - colour) < 8).all(axis=2)
    # 10 px per metre, the origin at 500: points on both borders, and on the far end 25 m away.
    for row, column in ((400, 400), (600, 400), (500, 250)):
        assert is_wedge[row - 1 : row + 2, column - 1 : column + 2].any()
    assert not is_wedge[:, 520:].any()


def test_names_of_cameras_with_the_same_direction_do_not_overlap():
    ground = GroundCoverage(np.zeros((2, 2), int), (-50.0, -50.0), (50.0, 50.0))
    one = [Wedge("A" * 20, np.zeros(2), 0.7, 0.0, -0.7)]
    both = [*one, Wedge("B" * 20, np.zeros(2), 0.7, 0.0, -0.7)]
    without = draw_coverage_map(ground, one, [])
    rows, _ = np.nonzero((draw_coverage_map(ground, both, []) != without).any(axis=2))
    name_rows = np.nonzero((without[:248] != draw_coverage_map(ground, [], [])[:248]).any(axis=2))[0]
    beyond = rows[rows < name_rows.min()]
    assert len(beyond) > 0  # the second name is farther from the origin than the first
