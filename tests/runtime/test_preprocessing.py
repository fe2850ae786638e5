from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from duospacenet.runtime import Camera, Frame
from duospacenet.runtime.bundle.manifest import Preprocessing
from duospacenet.runtime.geometry import project
from duospacenet.runtime.preprocessing import prepare_inputs, resize_transform

AHEAD = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1.0]])


def to_size(width_px, height_px):
    return Preprocessing(
        width_px=width_px,
        height_px=height_px,
        colour_order="bgr",
        resize_shrinking="area",
        resize_enlarging="linear",
        crop="centre columns, bottom rows",
        normalisation_in_graph={},
    )


def camera_of(width_px, height_px, focal_px=500.0):
    intrinsics = np.array([[focal_px, 0, width_px / 2], [0, focal_px, height_px / 2], [0, 0, 1.0]])
    return Camera(intrinsics, AHEAD, width_px, height_px)


def frame_of(**pictures):
    cameras = {name: camera_of(*picture.shape[1::-1]) for name, picture in pictures.items()}
    return Frame(pictures, cameras, np.eye(4), 0.0)


# Worked out by hand: (picture, network) -> scale in x and y, columns cut at the left, rows cut at the top.
FITS = {
    "nuScenes to 800x320": ((1600, 900), (800, 320), (0.5, 0.5), (0, 130)),
    "nuScenes to 400x160": ((1600, 900), (400, 160), (0.25, 0.25), (0, 65)),
    "nuScenes to 1600x640": ((1600, 900), (1600, 640), (1, 1), (0, 260)),
    "the network's own size": ((160, 64), (160, 64), (1, 1), (0, 0)),
    "a small picture is enlarged": ((80, 45), (160, 64), (2, 2), (0, 26)),
    "a wide picture loses its sides": ((1000, 160), (400, 160), (1, 1), (300, 0)),
    "an odd column goes to the right": ((405, 160), (400, 160), (1, 1), (2, 0)),
    # 320 / 450 of 1600 columns are 1137.8: the picture becomes 1138 wide, and the scale in x follows.
    "a scale that gives no whole pixels": ((1600, 450), (800, 320), (1138 / 1600, 320 / 450), (169, 0)),
}


@pytest.mark.parametrize("case", FITS)
def test_a_picture_covers_the_input_and_loses_its_sides_equally_and_its_top(case):
    picture, network, (scale_x, scale_y), (left, top) = FITS[case]
    expected = [[scale_x, 0, -left], [0, scale_y, -top], [0, 0, 1]]
    np.testing.assert_allclose(resize_transform(camera_of(*picture), to_size(*network)), expected, rtol=1e-15)


sizes = st.tuples(st.integers(1, 300), st.integers(1, 300))


@settings(deadline=None)
@given(picture=sizes, network=sizes)
def test_every_picture_fills_every_input(picture, network):
    frame = frame_of(A=np.full((picture[1], picture[0], 3), 200, np.uint8))
    images, _, _ = prepare_inputs(frame, to_size(*network), 1)
    assert images.shape == (1, network[1], network[0], 3)
    assert (images == 200).all()


@pytest.mark.parametrize(
    ("picture", "network"),
    [
        ((1600, 900), (800, 320)),
        ((1600, 900), (400, 160)),
        ((1600, 900), (704, 256)),
        ((1600, 450), (800, 320)),
        ((160, 90), (160, 64)),
        ((200, 120), (400, 160)),
        ((77, 60), (160, 64)),
    ],
)
@pytest.mark.parametrize("place", [(0.3, 0.6), (0.55, 0.75), (0.8, 0.9)])
def test_a_mark_in_the_picture_lies_where_its_point_is_projected_to(picture, network, place):
    size = max(4, picture[0] // 50)
    left, top = (int(fraction * extent) for fraction, extent in zip(place, picture, strict=True))
    image = np.zeros((picture[1], picture[0], 3), np.uint8)
    image[top : top + size, left : left + size] = 240
    frame = frame_of(A=image)
    # The block spans [left, left + size], since the first pixel's centre is at 0.5; the point lies 20 m ahead.
    camera = frame.cameras["A"]
    center = np.array([left + size / 2, top + size / 2])
    right_m, down_m = (center - camera.intrinsics_px[:2, 2]) / camera.intrinsics_px[0, 0] * 20
    prepared = prepare_inputs(frame, to_size(*network), 1)
    expected, _ = project(np.array([20, -right_m, -down_m]), prepared.image_T_ego[0].astype(np.float64))
    weights = prepared.images[0, ..., 0].astype(float)
    rows, columns = np.mgrid[: network[1], : network[0]] + 0.5
    found = [(weights * columns).sum() / weights.sum(), (weights * rows).sum() / weights.sum()]
    np.testing.assert_allclose(found, expected, atol=0.05)


def test_a_picture_shrinks_by_the_mean_of_its_areas():
    picture = np.random.default_rng(0).integers(0, 256, (900, 1600, 3), dtype=np.uint8)
    images, _, _ = prepare_inputs(frame_of(A=picture), to_size(400, 160), 1)
    expected = np.zeros((160, 400, 3))
    for row in range(160):
        for column in range(400):
            block = picture[4 * (row + 65) : 4 * (row + 66), 4 * column : 4 * (column + 1)]
            expected[row, column] = block.reshape(-1, 3).mean(axis=0)
    assert np.abs(images[0] - expected).max() <= 0.5 + 1e-9


def test_a_picture_of_the_right_size_passes_as_it_is():
    picture = np.random.default_rng(0).integers(0, 256, (64, 160, 3), dtype=np.uint8)
    images, projections, _ = prepare_inputs(frame_of(A=picture), to_size(160, 64), 1)
    assert np.array_equal(images[0], picture)
    np.testing.assert_array_equal(projections[0], (camera_of(160, 64).intrinsics_px @ AHEAD[:3]).astype(np.float32))


def test_colours_stay_blue_green_red():
    picture = np.full((900, 1600, 3), (200, 100, 50), np.uint8)
    images, _, _ = prepare_inputs(frame_of(A=picture), to_size(400, 160), 1)
    assert (images[0] == (200, 100, 50)).all()


def test_cameras_keep_their_order_and_lost_or_missing_ones_are_masked_zeros():
    ones = np.ones((64, 160, 3), np.uint8)
    frame = frame_of(B=ones, A=2 * ones, C=3 * ones)
    frame = replace(frame, images={"C": 3 * ones, "A": None, "B": ones})
    images, projections, valid = prepare_inputs(frame, to_size(160, 64), 5)
    assert images[:, 0, 0, 0].tolist() == [1, 0, 3, 0, 0]
    assert valid.tolist() == [True, False, True, False, False]
    assert not images[[1, 3, 4]].any()
    assert not projections[[3, 4]].any()
    assert (images.dtype, projections.dtype, valid.dtype) == (np.uint8, np.float32, np.bool_)


def test_cameras_of_one_rig_may_differ_in_size():
    pictures = {"A": np.full((900, 1600, 3), 9, np.uint8), "B": np.full((45, 80, 3), 7, np.uint8)}
    images, projections, _ = prepare_inputs(frame_of(**pictures), to_size(160, 64), 2)
    assert (images[0] == 9).all()
    assert (images[1] == 7).all()
    np.testing.assert_allclose(projections[:, 0, 1], [-500 * 0.1, -500 * 2.0], rtol=1e-6)


def test_the_projection_keeps_what_float64_gave_it():
    camera = replace(camera_of(1600, 900, focal_px=1266.417203046554), camera_T_ego=AHEAD @ np.diag([1.0, 1, 1, 1]))
    camera.camera_T_ego[:3, 3] = [0.3, 1.51, -1.7]
    frame = Frame({"A": None}, {"A": camera}, np.eye(4), 0.0)
    expected = np.diag([0.25, 0.25, 1]) @ camera.intrinsics_px @ camera.camera_T_ego[:3]
    expected[1] -= 65 * camera.camera_T_ego[2]
    _, projections, _ = prepare_inputs(frame, to_size(400, 160), 1)
    np.testing.assert_array_almost_equal_nulp(projections[0], expected.astype(np.float32), nulp=1)
