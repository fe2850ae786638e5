from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from duospacenet.runtime import Camera, Frame
from duospacenet.runtime.bundle.preprocessing_record import Normalisation, Preprocessing
from duospacenet.runtime.errors import InputError
from duospacenet.runtime.geometry import project
from duospacenet.runtime.preprocessing import decoding_reduction, prepare, resize_transform

LOOKING_FORWARD = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1.0]])


SHRINKING = ("area", "area by halvings")


def preprocessing_to(width_px, height_px, shrinking="area by halvings"):
    return Preprocessing(
        width_px=width_px,
        height_px=height_px,
        colour_order="bgr",
        resize_shrinking=shrinking,
        resize_enlarging="linear",
        crop="centre columns, bottom rows",
        normalisation_in_graph=Normalisation(colour_order="rgb", mean=(0, 0, 0), std=(1, 1, 1)),
    )


def camera_of(width_px, height_px, focal_px=500.0):
    intrinsics = np.array([[focal_px, 0, width_px / 2], [0, focal_px, height_px / 2], [0, 0, 1.0]])
    return Camera(intrinsics, LOOKING_FORWARD, width_px, height_px)


def frame_of(**images):
    cameras = {name: camera_of(*image.shape[1::-1]) for name, image in images.items()}
    return Frame(images, cameras, np.eye(4), 0.0)


# Computed by hand: image size and network size, scale in x and y, columns cropped on the left, rows cropped at the top.
RESIZE_CASES = {
    "nuScenes to 800x320": ((1600, 900), (800, 320), (0.5, 0.5), (0, 130)),
    "nuScenes to 400x160": ((1600, 900), (400, 160), (0.25, 0.25), (0, 65)),
    "nuScenes to 1600x640": ((1600, 900), (1600, 640), (1, 1), (0, 260)),
    "the network's own size": ((160, 64), (160, 64), (1, 1), (0, 0)),
    "a small image is enlarged": ((80, 45), (160, 64), (2, 2), (0, 26)),
    "a wide image is cropped on both sides": ((1000, 160), (400, 160), (1, 1), (300, 0)),
    "an odd number of columns crops one more on the right": ((405, 160), (400, 160), (1, 1), (2, 0)),
    # 320 / 450 of 1600 columns are 1137.8. The resized image has 1138 columns, and the scale in x is adapted.
    "the scale is adapted to whole pixels": ((1600, 450), (800, 320), (1138 / 1600, 320 / 450), (169, 0)),
}


@pytest.mark.parametrize("shrinking", SHRINKING)
@pytest.mark.parametrize("case", RESIZE_CASES)
def test_the_resize_transform_covers_the_input_and_crops_both_sides_equally_and_the_top(case, shrinking):
    image_size, network_size, (scale_x, scale_y), (left, top) = RESIZE_CASES[case]
    expected = [[scale_x, 0, -left], [0, scale_y, -top], [0, 0, 1]]
    np.testing.assert_allclose(
        resize_transform(camera_of(*image_size), preprocessing_to(*network_size, shrinking)), expected, rtol=1e-15
    )


sizes = st.tuples(st.integers(1, 300), st.integers(1, 300))


@settings(deadline=None)
@given(image_size=sizes, network_size=sizes, shrinking=st.sampled_from(SHRINKING))
def test_every_image_fills_an_input_of_every_size(image_size, network_size, shrinking):
    frame = frame_of(A=np.full((image_size[1], image_size[0], 3), 200, np.uint8))
    images, _, _ = prepare(frame, preprocessing_to(*network_size, shrinking), 1)
    assert images.shape == (1, network_size[1], network_size[0], 3)
    assert (images == 200).all()


@pytest.mark.parametrize(
    ("image_size", "network_size"),
    [
        ((1600, 900), (800, 320)),
        ((1600, 900), (400, 160)),
        ((1600, 900), (704, 256)),
        ((1600, 450), (800, 320)),
        ((1920, 1208), (400, 160)),
        ((801, 451), (160, 64)),
        ((160, 90), (160, 64)),
        ((200, 120), (400, 160)),
        ((77, 60), (160, 64)),
    ],
)
@pytest.mark.parametrize("place", [(0.3, 0.6), (0.55, 0.75), (0.8, 0.9)])
def test_a_bright_block_is_where_its_point_is_projected_to(image_size, network_size, place):
    size = max(4, image_size[0] // 50)
    left, top = (int(fraction * extent) for fraction, extent in zip(place, image_size, strict=True))
    image = np.zeros((image_size[1], image_size[0], 3), np.uint8)
    image[top : top + size, left : left + size] = 240
    frame = frame_of(A=image)
    # The centre of the first pixel is at 0.5, so the block spans [left, left + size]. Its point is 20 m ahead.
    camera = frame.cameras["A"]
    center = np.array([left + size / 2, top + size / 2])
    right_m, down_m = (center - camera.intrinsics_px[:2, 2]) / camera.intrinsics_px[0, 0] * 20
    prepared = prepare(frame, preprocessing_to(*network_size), 1)
    expected, _ = project(np.array([20, -right_m, -down_m]), prepared.image_T_ego[0].astype(np.float64))
    weights = prepared.images[0, ..., 0].astype(float)
    rows, columns = np.mgrid[: network_size[1], : network_size[0]] + 0.5
    centroid = [(weights * columns).sum() / weights.sum(), (weights * rows).sum() / weights.sum()]
    np.testing.assert_allclose(centroid, expected, atol=0.05)


def test_shrinking_averages_blocks_of_pixels():
    image = np.random.default_rng(0).integers(0, 256, (900, 1600, 3), dtype=np.uint8)
    images, _, _ = prepare(frame_of(A=image), preprocessing_to(400, 160, "area"), 1)
    expected = np.zeros((160, 400, 3))
    for row in range(160):
        for column in range(400):
            block = image[4 * (row + 65) : 4 * (row + 66), 4 * column : 4 * (column + 1)]
            expected[row, column] = block.reshape(-1, 3).mean(axis=0)
    assert np.abs(images[0] - expected).max() <= 0.5 + 1e-9


def random_image(width_px, height_px):
    return np.random.default_rng(0).integers(0, 256, (height_px, width_px, 3), dtype=np.uint8)


def halved(image):
    """Return the mean of each 2x2 block, with halves rounded up, from the formula in docs/frame-steps.md."""
    wide = image.astype(np.int64)
    return (wide[0::2, 0::2] + wide[0::2, 1::2] + wide[1::2, 0::2] + wide[1::2, 1::2] + 2) // 4


def area_average(image, width_px, height_px):
    """Return the average over the area of each scaled pixel, in float64."""
    rows, columns = _overlaps(image.shape[0], height_px), _overlaps(image.shape[1], width_px)
    return np.einsum("yr,rcb,xc->yxb", rows, image.astype(np.float64), columns, optimize=True)


def _overlaps(size_px, scaled_px):
    """Return the share of each pixel in each scaled pixel along one axis, (scaled_px, size_px)."""
    scale, overlaps = size_px / scaled_px, np.zeros((scaled_px, size_px))
    for scaled in range(scaled_px):
        for pixel in range(size_px):
            overlap = min((scaled + 1) * scale, pixel + 1) - max(scaled * scale, pixel)
            overlaps[scaled, pixel] = max(0.0, overlap) / scale
    return overlaps


# Image size, network size, size of the scaled image. The network's image is its bottom, or its middle columns.
SHRINKING_CASES = {
    "one halving": ((1600, 900), (800, 320), (800, 450)),
    "two halvings": ((1600, 900), (400, 160), (400, 225)),
    "no exact halving": ((1600, 900), (704, 256), (704, 396)),
    "an odd height": ((801, 451), (400, 160), (400, 225)),
    "an odd height after one halving": ((1600, 902), (400, 160), (400, 226)),
    "an eighth": ((1600, 900), (200, 80), (200, 112)),
    "columns are cropped": ((1280, 320), (400, 160), (640, 160)),
}


@pytest.mark.parametrize("case", SHRINKING_CASES)
def test_shrinking_by_halvings_is_within_one_grey_level_of_the_area_average(case):
    image_size, network_size, scaled_size = SHRINKING_CASES[case]
    image = random_image(*image_size)
    images, _, _ = prepare(frame_of(A=image), preprocessing_to(*network_size), 1)
    left, top = (scaled_size[0] - network_size[0]) // 2, scaled_size[1] - network_size[1]
    expected = area_average(image, *scaled_size)[top:, left : left + network_size[0]]
    assert np.abs(images[0] - expected).max() <= 1 + 1e-9


def test_halvings_have_the_bits_of_the_integer_formula():
    image = random_image(1600, 900)
    images, _, _ = prepare(frame_of(A=image), preprocessing_to(800, 320), 1)
    assert np.array_equal(images[0], halved(image)[130:])
    images, _, _ = prepare(frame_of(A=image), preprocessing_to(400, 160), 1)
    assert np.array_equal(images[0], halved(halved(image))[65:])


@pytest.mark.parametrize(
    ("image_size", "network_size"),
    [((801, 450), (160, 64)), ((1600, 900), (704, 256)), ((1602, 900), (400, 160)), ((1600, 904), (200, 80))],
)
def test_an_image_is_resized_once_if_halvings_do_not_lead_to_its_exact_size(image_size, network_size):
    image = random_image(*image_size)
    by_halvings, _, _ = prepare(frame_of(A=image), preprocessing_to(*network_size), 1)
    directly, _, _ = prepare(frame_of(A=image), preprocessing_to(*network_size, "area"), 1)
    assert np.array_equal(by_halvings, directly)


@pytest.mark.parametrize("network_size", [(400, 160), (800, 320), (704, 256)])
def test_bundles_of_earlier_schemas_resize_once(network_size):
    image = random_image(1600, 900)
    images, _, _ = prepare(frame_of(A=image), preprocessing_to(*network_size, "area"), 1)
    scaled_size = network_size[0], network_size[0] * 9 // 16
    expected = cv2.resize(image, scaled_size, interpolation=cv2.INTER_AREA)[-network_size[1] :]
    assert np.array_equal(images[0], expected)


def test_an_image_that_has_the_network_size_is_not_changed():
    image = np.random.default_rng(0).integers(0, 256, (64, 160, 3), dtype=np.uint8)
    images, projections, _ = prepare(frame_of(A=image), preprocessing_to(160, 64), 1)
    assert np.array_equal(images[0], image)
    np.testing.assert_array_equal(
        projections[0], (camera_of(160, 64).intrinsics_px @ LOOKING_FORWARD[:3]).astype(np.float32)
    )


def test_colours_stay_blue_green_red():
    image = np.full((900, 1600, 3), (200, 100, 50), np.uint8)
    images, _, _ = prepare(frame_of(A=image), preprocessing_to(400, 160), 1)
    assert (images[0] == (200, 100, 50)).all()


@pytest.mark.parametrize("image", [np.zeros((10_000, 1, 3), np.uint8), None])
def test_a_strip_that_would_be_enlarged_to_gigabytes_is_refused(image):
    frame = Frame({"front": image}, {"front": camera_of(1, 10_000)}, np.eye(4), 0.0)
    with pytest.raises(InputError, match=r"camera front: expected proportions .*, 400x160 px; got 1x10000 px\. Crop"):
        prepare(frame, preprocessing_to(400, 160), 1)


def test_cameras_keep_their_order_and_lost_cameras_and_unused_slots_are_masked_zeros():
    ones = np.ones((64, 160, 3), np.uint8)
    frame = frame_of(B=ones, A=2 * ones, C=3 * ones)
    frame = replace(frame, images={"C": 3 * ones, "A": None, "B": ones})
    images, projections, valid = prepare(frame, preprocessing_to(160, 64), 5)
    assert images[:, 0, 0, 0].tolist() == [1, 0, 3, 0, 0]
    assert valid.tolist() == [True, False, True, False, False]
    assert not images[[1, 3, 4]].any()
    assert not projections[[3, 4]].any()
    assert (images.dtype, projections.dtype, valid.dtype) == (np.uint8, np.float32, np.bool_)


def test_cameras_of_one_rig_can_have_different_sizes():
    images_by_camera = {"A": np.full((900, 1600, 3), 9, np.uint8), "B": np.full((45, 80, 3), 7, np.uint8)}
    images, projections, _ = prepare(frame_of(**images_by_camera), preprocessing_to(160, 64), 2)
    assert (images[0] == 9).all()
    assert (images[1] == 7).all()
    np.testing.assert_allclose(projections[:, 0, 1], [-500 * 0.1, -500 * 2.0], rtol=1e-6)


def test_the_projection_is_computed_in_float64_and_rounded_once():
    camera = replace(
        camera_of(1600, 900, focal_px=1266.417203046554), camera_T_ego=LOOKING_FORWARD @ np.diag([1.0, 1, 1, 1])
    )
    camera.camera_T_ego[:3, 3] = [0.3, 1.51, -1.7]
    frame = Frame({"A": None}, {"A": camera}, np.eye(4), 0.0)
    expected = np.diag([0.25, 0.25, 1]) @ camera.intrinsics_px @ camera.camera_T_ego[:3]
    expected[1] -= 65 * camera.camera_T_ego[2]
    _, projections, _ = prepare(frame, preprocessing_to(400, 160), 1)
    np.testing.assert_array_almost_equal_nulp(projections[0], expected.astype(np.float32), nulp=1)


# By hand. The scaled image of 1920x1208 is 400x252: a quarter, 480x302, is larger, but not twice as large.
REDUCTION_CASES = {
    "a quarter is the scaled image": ((1600, 900), (400, 160), 4),
    "a half is the scaled image": ((1600, 900), (800, 320), 2),
    "a quarter is four times as large": ((3200, 1800), (200, 80), 4),
    "a half is more than twice as large": ((1920, 1208), (400, 160), 2),
    "a half would be nearly the scaled image": ((1600, 900), (704, 256), 1),
    "the scaled image is the image": ((1600, 900), (1600, 640), 1),
    "an odd height": ((1600, 901), (400, 160), 1),
    "an odd height after one halving": ((1600, 902), (200, 80), 2),
    "enlarged": ((80, 45), (160, 64), 1),
}


@pytest.mark.parametrize("case", REDUCTION_CASES)
def test_an_image_is_decoded_at_a_reduced_size_if_that_is_the_scaled_size_or_twice_as_large(case):
    image_size, network_size, expected = REDUCTION_CASES[case]
    assert decoding_reduction(camera_of(*image_size), preprocessing_to(*network_size)) == expected


@pytest.mark.parametrize("network_size", [(400, 160), (704, 256), (1600, 640)])
def test_a_view_with_other_strides_gives_the_pixels_of_a_copy(network_size):
    view = random_image(1600, 900)[::-1, :, ::-1]
    of_view, of_copy = (
        prepare(frame_of(A=image), preprocessing_to(*network_size), 1).images for image in (view, view.copy())
    )
    assert np.array_equal(of_view, of_copy)
