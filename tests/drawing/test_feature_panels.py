"""Panels of features: the part of an image that the network sees, and the places of cells."""

import numpy as np
import pytest

from duospacenet.drawing.feature_panels import (
    cut_square,
    draw_bev_heat,
    draw_network_image,
    draw_pv_heat,
    network_projection,
)
from duospacenet.runtime.bundle.preprocessing_record import Normalisation, Preprocessing
from duospacenet.runtime.geometry import project
from duospacenet.runtime.preprocessing import prepare
from tests.helpers.pictures import make_camera, make_frame

NETWORK = Preprocessing(
    width_px=160,
    height_px=64,
    colour_order="bgr",
    resize_shrinking="area by halvings",
    resize_enlarging="linear",
    crop="centre columns, bottom rows",
    normalisation_in_graph=Normalisation(colour_order="rgb", mean=(0, 0, 0), std=(1, 1, 1)),
)


@pytest.mark.parametrize("reduction", [1, 2])
def test_the_panel_shows_the_part_of_the_image_that_the_network_sees(reduction):
    """640x360 is scaled by a quarter to 160x90, of which the 26 rows at the top are cropped: 104 rows of the image."""
    camera = make_camera()
    image = np.zeros((360 // reduction, 640 // reduction, 3), np.uint8)
    image[: 104 // reduction] = 255
    image[-4 // reduction :] = 77
    panel = draw_network_image(image, camera, NETWORK, (320, 128))
    assert panel.shape == (128, 320, 3)
    assert panel[:126].max() <= 77
    assert (panel[-1] == 77).all()
    inputs = prepare(make_frame({"a": image}, {"a": camera}), NETWORK, 1) if reduction == 1 else None
    if inputs is not None:
        np.testing.assert_array_equal(panel[::2, ::2][1:-2], inputs.images[0][1:-2])


def test_the_projection_to_a_panel_is_that_of_the_networks_inputs():
    camera = make_camera()
    inputs = prepare(make_frame({"a": None}, {"a": camera}), NETWORK, 1)
    points = np.array([(10.0, 2.0, 0.5), (30.0, -4.0, -1.0)])
    pixels, _ = project(points, network_projection(camera, NETWORK, (320, 128)))
    expected, _ = project(points, inputs.image_T_ego[0].astype(float))
    np.testing.assert_allclose(pixels, 2 * expected, rtol=1e-5)


def test_a_cell_of_the_pv_features_is_at_its_place_in_the_image():
    """Cells of 8 px; the last column of 21 is outside of the image of 160 px."""
    features = np.zeros((4, 8, 21), np.float32)
    features[:, 6, 4] = 5.0
    features[:, :, 20] = 5.0
    pictures = draw_pv_heat({"a": features, "b": np.zeros_like(features)}, NETWORK, (320, 128))
    assert pictures["a"].shape == (128, 320, 3)
    bright = pictures["a"].max(axis=2) > 200
    rows, columns = np.nonzero(bright[:, :300])
    # Cell (6, 4) has its centre at (4.5 * 16, 6.5 * 16) px of the panel.
    assert abs(rows.mean() - 104) < 2
    assert abs(columns.mean() - 72) < 2
    assert pictures["b"][:, :300].max() < 30


def test_a_lost_camera_has_no_pv_heat():
    assert draw_pv_heat({}, NETWORK, (320, 128)) == {}


def test_a_cell_of_the_bev_features_ahead_on_the_left_is_at_the_upper_left():
    features = np.zeros((3, 64, 64), np.float32)
    features[:, 60, 62] = 5.0  # x = 60.5 * 1.6 - 51.2 = 45.6 m, y = 62.5 * 1.6 - 51.2 = 48.8 m
    view = draw_bev_heat(features, 51.2, 640)
    view[300:340, 300:340] = 0  # the ego
    rows, columns = np.nonzero(view.max(axis=2) > 200)
    assert abs(rows.mean() - (51.2 - 45.6) * 6.25) < 3
    assert abs(columns.mean() - (51.2 - 48.8) * 6.25) < 3


def test_a_square_is_cut_around_its_centre_and_black_outside():
    picture = np.full((40, 40, 3), 90, np.uint8)
    picture[8:12, 18:22] = 200
    patch = cut_square(picture, (20, 10), 8, 80)
    assert patch.shape == (80, 80, 3)
    assert (patch[30:50, 30:50] == 200).all()
    assert (patch[:15, :15] == 90).all()
    rows, columns = np.nonzero(patch[..., 0] > 145)
    assert abs(rows.mean() - 39.5) < 0.6
    assert abs(columns.mean() - 39.5) < 0.6
    assert not cut_square(picture, (-20, -20), 8, 80).any()
