"""Heat of features, in cases worked by hand."""

import numpy as np

from duospacenet.drawing.heat import HeatScale, colour_heat, heat_of, scale_of

BLACK, BRIGHTEST = [4, 0, 0], [164, 255, 252]  # the ends of the inferno colours, BGR


def test_heat_is_the_distance_of_a_cell_from_the_mean_of_all_cells_of_all_images():
    features = np.zeros((2, 2, 1, 2), np.float32)
    features[1, :, 0, 1] = 4, 8
    # The mean over the four cells is (1, 2), so the distances are |(3, 6)| and |(1, 2)|.
    np.testing.assert_allclose(heat_of(features)[:, 0], [[5**0.5, 5**0.5], [5**0.5, 45**0.5]], rtol=1e-6)


def test_features_that_are_the_same_everywhere_have_no_heat():
    heat = heat_of(np.full((3, 4, 5, 6), 7.0))
    assert heat.shape == (3, 5, 6)
    assert not heat.any()
    assert (colour_heat(heat[0], scale_of(heat), (6, 5)) == BLACK).all()


def test_one_bright_cell_is_bright_where_it_is():
    features = np.zeros((1, 1, 10, 20), np.float32)
    features[0, 0, 2, 15] = 9.0
    heat = heat_of(features)
    picture = colour_heat(heat[0], scale_of(heat), (200, 100))
    assert picture[25, 155].tolist() == BRIGHTEST
    assert picture[75, 50].tolist() == BLACK


def test_colours_end_at_the_scale():
    picture = colour_heat(np.array([[0.0, 1.0, 5.0]], np.float32), HeatScale(1.0, 4.0), (3, 1))
    assert picture[0, [0, 1, 2]].tolist() == [BLACK, BLACK, BRIGHTEST]


def test_numbers_that_are_not_finite_and_empty_features_have_no_heat():
    features = np.ones((1, 2, 2, 2), np.float32)
    features[0, 0, 0, 0] = np.nan
    assert np.isfinite(heat_of(features)).all()
    assert heat_of(np.zeros((0, 3, 2, 2))).shape == (0, 2, 2)
    assert scale_of(np.zeros((0, 2, 2), np.float32)) == (0.0, 1.0)
