"""The ground grid over a camera's image: positions of lines, from the pinhole equation."""

import numpy as np

from duospacenet.drawing.ground_view import (
    CROP_COLOUR,
    FORWARD_COLOUR,
    GRID_COLOUR,
    HORIZON_COLOUR,
    LEFT_COLOUR,
    RING_COLOUR,
    draw_ground_view,
)
from tests.helpers.rigs import level_camera

# The cameras are 1.5 m above the origin: u = 640 - 640 y / x, v = 320 + 960 / x.


def draw_panel(camera, **changes):
    """The ground over a black image of 160x80 px, which becomes a panel of 1280x640 px with f = 640 px."""
    panel = draw_ground_view("", camera, np.zeros((80, 160, 3), np.uint8), [], **changes)
    return panel[:640]


def colour_at(picture, u, v):
    """The colour of the pixel that contains a point."""
    return tuple(picture[int(v), int(u)].tolist())


def test_a_camera_that_looks_ahead_shows_the_forward_axis_in_its_middle():
    assert colour_at(draw_panel(level_camera(0)), 640, 320 + 960 / 15) == FORWARD_COLOUR


def test_a_camera_that_looks_left_shows_the_left_axis_and_one_that_looks_right_shows_no_axis():
    assert colour_at(draw_panel(level_camera(90)), 640, 320 + 960 / 15) == LEFT_COLOUR
    right = draw_panel(level_camera(-90))
    assert not (right == LEFT_COLOUR).all(axis=2).any()
    assert not (right == FORWARD_COLOUR).all(axis=2)[:, 300:1000].any()


def test_a_camera_that_looks_half_left_shows_the_forward_axis_on_its_right():
    # For a camera that looks 30 degrees to the left, the point (15, 0) is at u = 640 + 640 tan 30 = 1009.5, at a depth
    # of 15 cos 30.
    panel = draw_panel(level_camera(30))
    u, v = 640 + 640 * np.tan(np.radians(30)), 320 + 960 / (15 * np.cos(np.radians(30)))
    assert colour_at(panel, u, v) == FORWARD_COLOUR
    assert colour_at(panel, 1280 - u, v) != FORWARD_COLOUR


def test_points_on_grid_lines_have_the_colour_of_the_grid():
    panel = draw_panel(level_camera(0))
    assert colour_at(panel, 640 - 640 * 10 / 25, 320 + 960 / 25) == GRID_COLOUR  # (25, 10), on y = 10
    assert colour_at(panel, 640 - 640 * 3 / 10, 320 + 960 / 10) == GRID_COLOUR  # (10, 3), on x = 10
    assert colour_at(panel, 640 - 640 * 3 / 7, 320 + 960 / 7) == (0, 0, 0)  # (7, 3), on no line


def test_the_10_m_ring_contains_the_points_8_m_ahead_and_6_m_to_the_side():
    panel = draw_panel(level_camera(0))
    for y in (6, -6):
        assert colour_at(panel, 640 - 640 * y / 8, 320 + 960 / 8) == RING_COLOUR


def test_rings_are_centred_at_the_ego_origin_and_not_at_the_camera():
    # The camera is 2 m ahead of the origin, so the 10 m ring is 8 m away. The point is slightly beside the axis.
    panel = draw_panel(level_camera(0, (2.0, 0, 1.5)))
    u, v = 640 - 640 * 0.4 / 7.992, 320 + 960 / 7.992
    assert colour_at(panel, u, v) == RING_COLOUR


def test_the_horizon_of_a_level_camera_is_level_with_no_line_above_it():
    panel = draw_panel(level_camera(0))
    assert colour_at(panel, 100, 320) == colour_at(panel, 1200, 320) == HORIZON_COLOUR
    assert not panel[40:317].any()


def test_the_horizon_is_lower_if_the_camera_looks_up():
    # The camera looks up by atan(1/4): the horizon is 640 / 4 px below the middle.
    cos, sin = 4 / np.sqrt(17), 1 / np.sqrt(17)
    up = level_camera(0)
    pitch_up = np.array([[1, 0, 0, 0], [0, cos, sin, 0], [0, -sin, cos, 0], [0, 0, 0, 1]])
    panel = draw_panel(level_camera(0, camera_T_ego=pitch_up @ up.camera_T_ego))
    assert colour_at(panel, 100, 480) == HORIZON_COLOUR
    assert not panel[40:470].any()


def test_lost_cameras_and_extreme_numbers_are_drawn_without_an_exception():
    lost = draw_ground_view("FRONT", level_camera(0), None, [])
    assert colour_at(lost, 640, 384) == FORWARD_COLOUR
    for extreme in (np.zeros((4, 4)), np.full((4, 4), 1e300), level_camera(0).camera_T_ego * 1e200):
        draw_ground_view("FRONT", level_camera(0, camera_T_ego=extreme), None, [])
    draw_ground_view("FRONT", level_camera(0, intrinsics_px=np.full((3, 3), 1e308)), None, [])
    draw_ground_view("FRONT", level_camera(0, width_px=10**9, height_px=1), None, [])


def test_the_crop_outline_surrounds_the_network_input():
    # The upper side of the outline is the middle row of the image.
    lower_half = np.array([(0, 40), (160, 40), (160, 80), (0, 80)], float)
    panel = draw_panel(level_camera(0), crop=lower_half)
    assert colour_at(panel, 100, 320) == colour_at(panel, 0, 500) == CROP_COLOUR
    assert not (panel[40:310] == CROP_COLOUR).all(axis=2).any()


def test_a_long_name_stays_in_its_panel():
    panel = draw_ground_view("W" * 200, level_camera(0), None, [])
    assert (panel[:5, -4:] == panel[50, -4:]).all()
