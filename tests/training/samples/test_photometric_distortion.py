"""Tests of the photometric distortion, against hand-worked colours and the colour conversions of Python's library."""

import colorsys

import numpy as np
import pytest

from duospacenet.training.samples.photometric_distortion import PhotometricDistortion, sample_photometric_distortion


def one_pixel(*bgr):
    return np.array([[bgr]], np.uint8)


def random_image():
    return np.random.default_rng(0).integers(0, 256, (6, 7, 3), np.uint8)


@pytest.mark.parametrize("first", [True, False])
def test_the_default_distortion_changes_no_bit(first):
    image = random_image()
    np.testing.assert_array_equal(PhotometricDistortion(contrast_first=first)(image), image)


@pytest.mark.parametrize(
    ("distortion", "expected"),
    [
        (PhotometricDistortion(brightness=20), (30, 120, 255)),
        (PhotometricDistortion(brightness=-20), (0, 80, 230)),
        (PhotometricDistortion(contrast=1.5), (15, 150, 255)),
        (PhotometricDistortion(contrast=0.5, contrast_first=False), (5, 50, 125)),
        (PhotometricDistortion(brightness=20, contrast=0.5), (15, 60, 135)),
        (PhotometricDistortion(saturation=0), (250, 250, 250)),
        # The range of this colour is 240 of 250. Half the saturation halves the distance of each channel to 250.
        (PhotometricDistortion(saturation=0.5), (130, 175, 250)),
    ],
)
def test_distortions_worked_by_hand(distortion, expected):
    assert distortion(one_pixel(10, 100, 250)).tolist() == [[list(expected)]]


def test_the_contrast_is_applied_before_or_after_the_saturation():
    """BGR (0, 0, 200), contrast 1.5: red is clipped to 255 before, or is 200 during, the change of saturation."""
    values = {"contrast": 1.5, "saturation": 0.5}
    before = PhotometricDistortion(**values, contrast_first=True)(one_pixel(0, 0, 200))
    after = PhotometricDistortion(**values, contrast_first=False)(one_pixel(0, 0, 200))
    assert before.tolist() == [[[128, 128, 255]]]
    assert after.tolist() == [[[150, 150, 255]]]


@pytest.mark.parametrize("shape", [(6, 7), (1, 4), (4, 1), (1, 1)])
@pytest.mark.parametrize(("saturation", "hue_deg"), [(1.0, 18.0), (1.3, 0.0), (0.6, -11.0)])
def test_saturation_and_hue_equal_those_of_colorsys(saturation, hue_deg, shape):
    image = random_image()[: shape[0], : shape[1]]
    distorted = PhotometricDistortion(saturation=saturation, hue_deg=hue_deg)(image)
    for before, after in zip(image.reshape(-1, 3), distorted.reshape(-1, 3), strict=True):
        h, s, v = colorsys.rgb_to_hsv(*(before[::-1] / 255))
        rgb = colorsys.hsv_to_rgb((h + hue_deg / 360) % 1, min(s * saturation, 1), v)
        np.testing.assert_allclose(after[::-1], 255 * np.array(rgb), atol=0.51)


def test_the_image_itself_is_not_changed():
    image = random_image()
    PhotometricDistortion(10, 1.2, 1.2, 5)(image)
    np.testing.assert_array_equal(image, random_image())


def test_sampled_distortions_are_within_the_ranges_of_mmdetection_and_half_of_them_are_off():
    rng = np.random.default_rng(0)
    sampled = [sample_photometric_distortion(rng) for _ in range(2000)]
    fields = {
        "brightness": (0, -32, 32),
        "contrast": (1, 0.5, 1.5),
        "saturation": (1, 0.5, 1.5),
        "hue_deg": (0, -18, 18),
    }
    for name, (off, lower, upper) in fields.items():
        values = np.array([getattr(distortion, name) for distortion in sampled])
        assert (values == off).mean() == pytest.approx(0.5, abs=0.06), name  # five standard deviations
        changed = values[values != off]
        assert lower <= changed.min() < lower + 0.02 * (upper - lower), name
        assert upper - 0.02 * (upper - lower) < changed.max() <= upper, name
    assert np.mean([distortion.contrast_first for distortion in sampled]) == pytest.approx(0.5, abs=0.06)
