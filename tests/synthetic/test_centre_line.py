"""Centre lines, by the formulas of straight lines and circles."""

import numpy as np

from duospacenet.synthetic.centre_line import CentreLine


def test_places_beside_a_straight_line_are_to_its_left():
    line = CentreLine(-10.0, 1.0, np.full(21, np.pi / 2), np.array([3.0, 4.0]))  # along y
    assert line.ends_m == (-10.0, 10.0)
    positions = line.positions(np.array([0.0, 5.0]), np.array([2.0, -1.0]))
    np.testing.assert_allclose(positions, [[1.0, 4.0], [4.0, 9.0]], atol=1e-12)


def test_places_of_a_bend_are_on_a_circle_and_beside_it_on_a_smaller_one():
    radius, step = 50.0, 0.5
    along = np.arange(0.0, 60.0, step)
    line = CentreLine(0.0, step, along / radius, np.zeros(2))
    centre = np.array([0.0, radius])  # a turn to the left
    asked = np.linspace(0.0, 59.0, 23)
    for across in (0.0, 10.0, -10.0):
        distances = np.linalg.norm(line.positions(asked, across) - centre, axis=1)
        np.testing.assert_allclose(distances, radius - across, atol=1e-3)
    np.testing.assert_allclose(line.interpolate(asked)[:, 3], 1 / radius, atol=1e-9)


def test_a_strip_is_a_closed_outline_of_its_width():
    line = CentreLine(-10.0, 1.0, np.zeros(21), np.zeros(2))
    outline = line.strip(0.0, 6.0, -1.0, 2.0)
    assert outline.tolist() == [[0, -1], [3, -1], [6, -1], [6, 2], [3, 2], [0, 2]]
