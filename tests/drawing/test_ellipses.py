"""Ellipses around boxes, at positions computed by hand."""

import numpy as np

from duospacenet.drawing.bird_eye_view import to_view_pixels
from duospacenet.drawing.camera_panel import panel_projection
from duospacenet.drawing.canvas import blank
from duospacenet.drawing.ellipses import ELLIPSE_COLOUR, draw_ellipses_above, draw_ellipses_in_camera
from tests.helpers.pictures import SIZE_PX, box, difference, make_camera

RANGE_M, SIZE = 51.2, 512  # five pixels per metre


def drawn_above(boxes):
    view = blank(SIZE, SIZE, (0, 0, 0))
    draw_ellipses_above(view, boxes, RANGE_M)
    return view


def drawn_ahead(boxes):
    panel = blank(*SIZE_PX, (0, 0, 0))
    draw_ellipses_in_camera(panel, boxes, panel_projection(make_camera(), SIZE_PX))
    return panel


def test_an_ellipse_from_above_surrounds_the_corners_of_its_box():
    # 2 m by 4 m are 10 by 20 px. The ellipse through the corners has semi-axes of 10 / sqrt(2) = 7.1 and 14.1 px; the
    # margin adds 7 px.
    view = drawn_above(box(20, 10))
    rows, columns = difference(view, np.zeros_like(view))
    assert abs((rows.max() - rows.min()) / 2 - 21.1) < 2
    assert abs((columns.max() - columns.min()) / 2 - 14.1) < 2
    centre = to_view_pixels(np.array([20.0, 10.0]), RANGE_M, SIZE)
    np.testing.assert_allclose([columns.mean(), rows.mean()], centre, atol=1)
    assert (view == ELLIPSE_COLOUR).all(axis=2).any()


def test_an_ellipse_in_a_camera_surrounds_the_projected_box():
    # The front is at 18 m and the rear at 22 m. The nearest corners are (+-1 * 200 / 18) px beside the middle.
    panel = drawn_ahead(box(20, 0))
    rows, columns = difference(panel, np.zeros_like(panel))
    half_px = np.sqrt(0.5) * 2 * 200 / 18 + 7
    assert abs((columns.max() - columns.min()) / 2 - half_px) < 2
    assert abs((rows.max() - rows.min()) / 2 - half_px) < 2
    assert abs(columns.mean() - 320) < 1
    assert abs(rows.mean() - 180) < 1


def test_boxes_outside_of_the_image_have_no_ellipse():
    for outside in (box(-20, 0), box(20, 200), box(np.nan, 0)):
        assert not drawn_ahead(outside).any()
    with np.errstate(all="ignore"):
        assert not drawn_above(box(np.inf, 0)).any()


def test_the_ellipse_of_a_box_that_crosses_the_border_is_around_its_visible_part():
    # The box begins at 320 + 200 * 4 / 7 = 434.3 px and ends far beyond the right border, at 640 px.
    panel = drawn_ahead(box(4, -6, w=4, l=6))
    _, columns = difference(panel, np.zeros_like(panel))
    middle, half_px = (434.3 + 640) / 2, np.sqrt(0.5) * (640 - 434.3) + 7
    assert abs(columns.min() - (middle - half_px)) < 4
