"""Lines on a picture."""

import numpy as np

from duospacenet.drawing.canvas import draw_segments


class TestCanvas:
    def test_a_line_that_leaves_the_picture_on_both_sides_crosses_the_whole_picture(self):
        picture = np.zeros((9, 20, 3), np.uint8)
        draw_segments(picture, [[(-1e12, 4.5), (1e12, 4.5)]], (255, 255, 255))
        assert picture[4, 1:].min() > 200
        assert picture[[0, 1, 7, 8]].max() == 0

    def test_a_slanted_line_keeps_its_slope_when_it_is_clipped(self):
        picture = np.zeros((101, 101, 3), np.uint8)
        draw_segments(picture, [[(-1e7, -1e7), (1e7, 1e7)]], (255, 255, 255))
        assert picture[np.arange(101), np.arange(101)].min() > 150
