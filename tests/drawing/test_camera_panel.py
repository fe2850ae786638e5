"""Boxes in camera panels."""

import numpy as np
import pytest

from duospacenet.drawing.box_style import CLASS_COLOURS, style_detections
from duospacenet.drawing.camera_panel import draw_camera, project_segments
from duospacenet.drawing.frame_picture import draw_frame
from tests.helpers.pictures import (
    AHEAD,
    LEFT,
    SIZE_PX,
    box,
    difference,
    ground_truth_boxes,
    make_camera,
    surround_frame,
)


def draw_panel(*box_groups, camera=None):
    """The panel of a camera without its name, on a black image."""
    image = np.zeros((360, 640, 3), np.uint8)
    return draw_camera("", camera or make_camera(), image, list(box_groups), SIZE_PX, scale=1.0)


def changed_pixels(panel):
    """Rows and columns of the pixels that differ from an empty panel."""
    return difference(panel, draw_panel())


class TestBoxesInCameras:
    def test_the_near_face_of_a_box_is_drawn_where_the_pinhole_projects_it(self):
        # x = 10, y = 1 and -1, z = 1 and -1: u = 320 -+ 20, v = 180 -+ 20; the far face, x = 14, is inside.
        rows, columns = changed_pixels(draw_panel(ground_truth_boxes(box(12, 0))))
        assert (rows.min(), rows.max()) == (159, 200)
        assert (columns.min(), columns.max()) == (299, 340)

    def test_a_line_on_the_border_of_two_pixels_changes_both_alike(self):
        green = draw_panel(ground_truth_boxes(box(12, 0)))[..., 1].astype(int)
        left_of_300, right_of_300 = green[190, 299], green[190, 300]
        assert min(left_of_300, right_of_300) > 100
        assert abs(left_of_300 - right_of_300) < 20

    def test_a_panel_can_have_another_size_than_its_image(self):
        image = np.zeros((360, 640, 3), np.uint8)
        empty = draw_camera("", make_camera(), image, [], (320, 180), scale=1.0)
        panel = draw_camera("", make_camera(), image, [ground_truth_boxes(box(12, 0))], (320, 180), scale=1.0)
        rows, columns = difference(panel, empty)
        assert (rows.min(), rows.max()) == (79, 100)
        assert (columns.min(), columns.max()) == (149, 170)

    def test_a_box_to_the_left_of_the_ego_is_ahead_of_a_left_camera(self):
        rows, columns = changed_pixels(draw_panel(ground_truth_boxes(box(0, 12, w=4, l=2)), camera=make_camera(LEFT)))
        assert (columns.min(), columns.max()) == (299, 340)
        assert (rows.min(), rows.max()) == (159, 200)

    def test_a_box_behind_the_camera_is_not_drawn(self):
        assert changed_pixels(draw_panel(ground_truth_boxes(box(-12, 0))))[0].size == 0

    def test_a_box_beside_the_image_is_not_drawn(self):
        assert changed_pixels(draw_panel(ground_truth_boxes(box(10, 40))))[0].size == 0

    def test_a_box_partly_behind_the_camera_is_drawn_up_to_the_image_border_and_not_mirrored(self):
        # From x = 2 back past the camera, at y = 0.5 .. 2.5: the lower inner edge starts at u = 320 - 200 / 4
        # and v = 180 + 200 / 2, and runs down to the left along v - 180 = 2 (320 - u).
        panel = draw_panel(ground_truth_boxes(box(0, 1.5)))
        _, columns = changed_pixels(panel)
        assert columns.max() in (269, 270, 271)
        assert columns.min() == 0
        assert panel[329:331, 244:246, 1].min() > 100

    def test_lines_are_clipped_at_the_nearest_depth(self):
        # From 2 m ahead to 2 m behind, one metre to the right: cut at depth 0.1 m, u = 320 + 200 / 0.1.
        line = np.array([[[2.0, -1.0, 0.0], [-2.0, -1.0, 0.0]]])
        pixels = project_segments(line, make_camera().intrinsics_px @ AHEAD[:3])
        np.testing.assert_allclose(pixels, [[[420, 180], [2320, 180]]])

    def test_a_near_box_is_drawn_over_a_far_one_in_any_order(self):
        # The upper edge of the car's near face, x = 20 and z = 0, runs along v = 180, from u = 280 to 360;
        # the pedestrian's left edge, at u = 300, crosses it.
        boxes = np.concatenate([box(12, 0), box(22, 0, z=-1, w=8)])
        near_first = draw_panel(style_detections(boxes, ["pedestrian", "car"], None, scale=0.5))
        far_first = draw_panel(style_detections(boxes[::-1], ["car", "pedestrian"], None, scale=0.5))
        np.testing.assert_array_equal(near_first, far_first)
        beside, crossing = near_first[180, 290].astype(int), near_first[180, 300].astype(int)
        assert beside[0] > 1.5 * beside[2]  # blue, the car's
        assert crossing[2] > 1.5 * crossing[0]  # yellow, the pedestrian's

    def test_the_front_face_of_a_detection_is_tinted(self):
        # u = 303 is on the near face, x = 10, but beside the far one, x = 14, which starts at u = 305.7.
        away = draw_panel(style_detections(box(12, 0), ["car"], None, scale=0.5))
        toward = draw_panel(style_detections(box(12, 0, yaw=np.pi), ["car"], None, scale=0.5))
        assert away[180, 303].max() == 0
        np.testing.assert_allclose(toward[180, 303], 0.35 * np.array(CLASS_COLOURS["car"]), atol=1)

    def test_ground_truth_is_green_and_a_detection_has_the_colour_of_its_class(self):
        rows, columns = changed_pixels(draw_panel(ground_truth_boxes(box(12, 0))))
        blue, green, red = draw_panel(ground_truth_boxes(box(12, 0)))[rows, columns].sum(axis=0)
        assert green > 1.5 * max(blue, red)
        blue, green, red = draw_panel(style_detections(box(12, 0), ["car"], None, 1.0)).sum(axis=(0, 1))
        assert blue > 1.3 * green > 1.3 * red

    def test_scores_are_written_above_boxes(self):
        without = draw_panel(style_detections(box(12, 0), ["car"], None, 1.0))
        with_score = draw_panel(style_detections(box(12, 0), ["car"], [0.87], 1.0))
        rows, columns = np.nonzero((with_score != without).any(axis=2))
        assert 140 < rows.min() < rows.max() < 160
        assert columns.min() >= 298

    @pytest.mark.parametrize("size_m", [1e3, 1e9, 1e300, np.nan, np.inf])
    @pytest.mark.filterwarnings("ignore::RuntimeWarning")
    def test_a_box_of_any_size_does_not_disturb_other_boxes(self, size_m):
        boxes = np.concatenate([box(12, 0), box(12, 0, w=size_m, l=size_m, h=size_m)])
        picture = draw_frame(surround_frame(), boxes, ["car", "bus"], [0.5, 0.5])
        assert picture.shape == draw_frame(surround_frame(), box(12, 0), ["car"]).shape
        rows, columns = changed_pixels(draw_panel(ground_truth_boxes(boxes)))
        assert {(160, 300), (199, 339)} <= set(zip(rows.tolist(), columns.tolist(), strict=True))

    @pytest.mark.filterwarnings("ignore::RuntimeWarning")
    def test_a_camera_that_looks_down_draws_no_box_of_infinite_height(self):
        cos, sin = np.cos(0.2), np.sin(0.2)
        tilted = np.array([[1, 0, 0, 0], [0, cos, -sin, 0], [0, sin, cos, 0], [0, 0, 0, 1.0]]) @ AHEAD
        assert (
            changed_pixels(draw_panel(ground_truth_boxes(box(12, 0, h=np.inf)), camera=make_camera(tilted)))[0].size
            == 0
        )
