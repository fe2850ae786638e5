"""The arrangement of panels, against pixels worked out by hand."""

import numpy as np

from duospacenet.drawing.canvas import blank
from duospacenet.drawing.frame_picture import BACKGROUND_COLOUR
from duospacenet.drawing.panel_layout import GAP_PX, pad, place_below, place_beside

WHITE, RED = (255, 255, 255), (0, 0, 255)


def test_a_lower_picture_beside_a_higher_one_is_padded_below():
    row = place_beside([blank(4, 10, WHITE), blank(3, 6, RED)], gap_px=2)
    assert row.shape == (10, 4 + 2 + 3, 3)
    assert (row[:, :4] == WHITE).all()
    assert (row[:, 4:6] == BACKGROUND_COLOUR).all()
    assert (row[:6, 6:] == RED).all()
    assert (row[6:, 6:] == BACKGROUND_COLOUR).all()


def test_pictures_below_each_other_have_a_gap_between_them_only():
    column = place_below([blank(4, 2, WHITE), blank(4, 3, RED)])
    assert column.shape == (2 + GAP_PX + 3, 4, 3)
    assert (column[:2] == WHITE).all()
    assert (column[2:-3] == BACKGROUND_COLOUR).all()
    assert (column[-3:] == RED).all()


def test_a_centred_picture_has_the_same_margin_at_both_sides():
    padded = pad(blank(2, 1, WHITE), 6, 3, centred=True)
    white = (padded == WHITE).all(axis=2)
    np.testing.assert_array_equal(white, [[0, 0, 1, 1, 0, 0], [0] * 6, [0] * 6])
