"""Boxes and maps in the bird's-eye view."""

import numpy as np
import pytest

from duospacenet.drawing.bird_eye_view import draw_bird_eye_view
from tests.helpers.pictures import box, difference, ground_truth_boxes


class TestBirdEyeView:
    """512 pixels for 102.4 m: five pixels per metre; the ego is at (256, 256)."""

    def view(self, *box_groups, maps=None):
        return draw_bird_eye_view(list(box_groups), maps or {}, range_m=51.2, size_px=512, scale=1.0)

    def changed_pixels(self, *box_groups, maps=None):
        return difference(self.view(*box_groups, maps=maps), self.view())

    def test_a_box_ahead_on_the_left_is_drawn_at_the_upper_left(self):
        # x = 20, y = 10: u = (51.2 - 10) * 5 = 206, v = (51.2 - 20) * 5 = 156; 2 m wide, 4 m long upwards.
        rows, columns = self.changed_pixels(ground_truth_boxes(box(20, 10)))
        assert (rows.min(), rows.max()) == (145, 166)
        assert (columns.min(), columns.max()) == (200, 211)

    @pytest.mark.parametrize(
        ("yaw", "front", "rear"),
        [(0.0, (151, 206), (161, 206)), (np.pi / 2, (156, 201), (156, 211))],
    )
    def test_the_heading_line_goes_from_the_centre_to_the_front(self, yaw, front, rear):
        green = self.view(ground_truth_boxes(box(20, 10, yaw=yaw)))[..., 1]
        assert green[front] > 100
        assert green[rear] < 100

    def test_the_arrow_ends_where_the_box_will_be_after_one_second(self):
        # 6 m/s to the left: from u = 206 to 176.
        rows, columns = self.changed_pixels(ground_truth_boxes(box(20, 10, vy=6.0)))
        assert columns.min() in (175, 176)
        assert rows[columns == columns.min()].mean() == 155.5

    def test_an_unknown_velocity_has_no_arrow(self):
        still, unknown = ground_truth_boxes(box(20, 10)), ground_truth_boxes(box(20, 10, vx=np.nan, vy=np.nan))
        np.testing.assert_array_equal(self.view(unknown), self.view(still))

    def test_rings_are_ten_metres_apart(self):
        # Straight to the left of the ego, where no label is: columns 206, 156, 106, 56, 6.
        brightness = self.view()[256, :230].astype(int).sum(axis=1)
        ring = np.nonzero(brightness > brightness.min() + 60)[0]
        expected = np.array([6, 56, 106, 156, 206])
        assert {int(np.argmin(np.abs(expected + 0.0 - column))) for column in ring} == set(range(5))
        assert all(np.abs(expected - (column + 0.5)).min() <= 1 for column in ring)

    def test_the_ego_points_up(self):
        white = (self.view() == 240).all(axis=2)
        rows, columns = np.nonzero(white)
        assert (rows < 256).sum() > 2 * (rows >= 256).sum()
        assert abs(columns.mean() + 0.5 - 256) < 1

    def test_a_map_cell_far_ahead_on_the_left_is_tinted_at_the_upper_left(self):
        # 16 x 16 cells of 32 pixels: i = 15 is the farthest ahead, j = 12 the fourth from the left.
        mask = np.zeros((16, 16), bool)
        mask[15, 12] = True
        rows, columns = self.changed_pixels(maps={"drivable_area": mask})
        assert (rows.min(), rows.max()) == (0, 31)
        assert (columns.min(), columns.max()) == (96, 127)

    def test_a_probability_of_one_half_tints_half_as_much(self):
        ground, half, full = (
            self.view(maps={"drivable_area": np.full((4, 4), value)})[3, 3].astype(float) for value in (0.0, 0.5, 1.0)
        )
        np.testing.assert_allclose(half, (ground + full) / 2, atol=1)
        assert np.abs(full - ground).max() > 20

    def test_a_box_out_of_range_is_not_drawn(self):
        assert self.changed_pixels(ground_truth_boxes(box(80, 10)))[0].size == 0
