"""Tests of the geometric augmentation of images: pixels move to where points are projected."""

import numpy as np
import pytest

from duospacenet.runtime.geometry import project
from duospacenet.training.samples.image_transform import image_transform, sample_image_transform, transform_image

GREY = np.array([9, 9, 9], np.uint8)
UNCHANGED = {"scale": 1.0, "angle_rad": 0.0, "shift_px": np.zeros(2), "flip": 1.0}


def transform_of(width, height, **changes):
    return image_transform((width, height), **UNCHANGED | changes)


def random_image(width, height):
    return np.random.default_rng(0).integers(0, 256, (height, width, 3), np.uint8)


def test_without_changes_an_image_keeps_every_pixel():
    image = random_image(8, 5)
    np.testing.assert_array_equal(transform_image(image, transform_of(8, 5), GREY), image)


def test_a_flip_exchanges_the_first_and_the_last_column():
    """A point at x moves to width - x."""
    new_T_old = transform_of(8, 5, flip=-1.0)
    np.testing.assert_allclose(new_T_old @ [0.5, 2.0, 1.0], [7.5, 2.0, 1.0])
    image = random_image(8, 5)
    np.testing.assert_array_equal(transform_image(image, new_T_old, GREY), image[:, ::-1])


def test_a_quarter_turn_moves_the_right_edge_to_the_bottom():
    """The rotation is from x, right, to y, down: clockwise as an image is seen."""
    new_T_old = transform_of(6, 6, angle_rad=np.pi / 2)
    np.testing.assert_allclose(new_T_old @ [6.0, 3.0, 1.0], [3.0, 6.0, 1.0], atol=1e-12)
    image = random_image(6, 6)
    np.testing.assert_array_equal(transform_image(image, new_T_old, GREY), np.rot90(image, k=-1))


def test_a_shift_crops_one_edge_and_fills_the_other():
    image = random_image(8, 5)
    moved = transform_image(image, transform_of(8, 5, shift_px=np.array([3.0, -2.0])), GREY)
    np.testing.assert_array_equal(moved[:3, 3:], image[2:, :5])
    assert (moved[3:] == 9).all()
    assert (moved[:, :3] == 9).all()


def test_twice_the_scale_shows_the_centre_with_the_corners_of_pixels_in_place():
    """The left half of an 8-pixel image is black and the right half is white; so is the enlarged image."""
    image = np.zeros((4, 8, 3), np.uint8)
    image[:, 4:] = 200
    new_T_old = transform_of(8, 4, scale=2.0)
    np.testing.assert_allclose(new_T_old @ [4.0, 2.0, 1.0], [4.0, 2.0, 1.0])
    np.testing.assert_allclose(new_T_old @ [2.0, 1.0, 1.0], [0.0, 0.0, 1.0])
    moved = transform_image(image, new_T_old, GREY)
    # The centres of the new columns 3 and 4 are at 3.75 and 4.25 in the old image, between the centres 3.5 and 4.5.
    np.testing.assert_array_equal(moved[0, :, 0], [0, 0, 0, 50, 150, 200, 200, 200])


def draw_spot(size, centre_px):
    """A smooth spot, so that its centre can be measured to a fraction of a pixel."""
    x, y = np.meshgrid(np.arange(size[0]) + 0.5, np.arange(size[1]) + 0.5)
    spot = 250 * np.exp(-((x - centre_px[0]) ** 2 + (y - centre_px[1]) ** 2) / (2 * 2.5**2))
    return np.repeat(spot[..., None], 3, axis=2).round().astype(np.uint8)


def measure_spot(image):
    weights = image[..., 0].astype(float)
    x, y = np.meshgrid(np.arange(image.shape[1]) + 0.5, np.arange(image.shape[0]) + 0.5)
    return np.array([(x * weights).sum(), (y * weights).sum()]) / weights.sum()


@pytest.mark.parametrize("seed", range(6))
def test_the_pixels_of_a_point_are_where_the_adapted_projection_has_it(seed):
    """The spot is at the projection of a point 10 m ahead. Black is also the colour around the image."""
    size = (160, 96)
    image_T_ego = np.array([[80.0, -100, 0, 5], [48, 0, -100, 20], [1, 0, 0, 0.5]])
    point = np.array([10.0, 2.0, -0.5])
    before, depth_m = project(point, image_T_ego)
    new_T_old = sample_image_transform(*size, np.random.default_rng(seed))
    after, depth_after_m = project(point, new_T_old @ image_T_ego)
    assert depth_after_m == depth_m == 10.5
    assert np.linalg.norm(after - before) > 1
    moved = transform_image(draw_spot(size, before), new_T_old, np.zeros(3, np.uint8))
    np.testing.assert_allclose(measure_spot(moved), after, atol=0.06)


def test_sampled_transforms_scale_rotate_shift_and_flip_within_their_ranges():
    rng = np.random.default_rng(0)
    sampled = [sample_image_transform(200, 100, rng) for _ in range(2000)]
    linear = np.array([new_T_old[:2, :2] for new_T_old in sampled])
    determinants = np.linalg.det(linear)
    assert (determinants < 0).mean() == pytest.approx(0.5, abs=0.06)
    scales = np.sqrt(np.abs(determinants))
    assert (scales.min(), scales.max()) == pytest.approx((0.9, 1.1), abs=2e-3)
    degrees = np.degrees(np.arctan2(linear[:, 0, 1], linear[:, 1, 1]))
    assert (degrees.min(), degrees.max()) == pytest.approx((-5.4, 5.4), abs=0.05)
    centres = np.array([(new_T_old @ [100, 50, 1])[:2] for new_T_old in sampled]) - [100, 50]
    np.testing.assert_allclose(centres.min(axis=0), [-10, -5], atol=0.1)
    np.testing.assert_allclose(centres.max(axis=0), [10, 5], atol=0.1)
