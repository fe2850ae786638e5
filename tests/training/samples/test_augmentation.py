"""Tests of the augmentation of clips: what it depends on, and what it changes in a training frame."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from duospacenet.training.samples.augmentation import sample_augmentation
from duospacenet.training.samples.clip_loader import load_clips
from duospacenet.training.samples.image_transform import transform_image
from duospacenet.weights.input_contract import preprocessing
from tests.helpers.trainings import TINY, FixedClips, settings_with, synthetic_frames, synthetic_training_frames

BOTH = settings_with(photometric=True, geometric=True)


def load(settings, number=0, config=TINY):
    clips = FixedClips((synthetic_frames(1, 2),))
    return next(load_clips(clips, config, preprocessing(config), range(number, number + 1), 0, settings))


def augmentation_where(condition, settings=BOTH):
    """The number and the augmentation of the first clip for which a condition holds."""
    for number in range(100):
        augmentation = sample_augmentation(settings, TINY, number)
        if condition(augmentation):
            return number, augmentation
    raise AssertionError("no such clip")


def assert_equal_frames(one, other):
    assert all(torch.equal(a, b) for a, b in zip(one, other, strict=True))


def test_without_augmentation_no_bit_changes():
    for loaded, frame in zip(load(settings_with()), synthetic_training_frames(1, 2), strict=True):
        assert_equal_frames(loaded, frame)


def test_the_augmentation_depends_on_the_seed_and_the_number_of_the_clip_only():
    for settings in (settings_with(photometric=True), settings_with(geometric=True), BOTH):
        for one, other in zip(load(settings, 3), load(replace(settings, steps=9, batch_size=4), 3), strict=True):
            assert_equal_frames(one, other)
        for changed in (load(settings, 4), load(replace(settings, seed=1), 3)):
            assert not torch.equal(load(settings, 3)[0].images, changed[0].images)


def test_all_frames_of_a_clip_have_the_same_augmentation():
    """The images of both frames are transformed by the same maps, which are those of their projections."""
    number, augmentation = augmentation_where(lambda augmentation: not augmentation.mirrored)
    for loaded, frame in zip(load(BOTH, number), synthetic_training_frames(1, 2), strict=True):
        for camera, new_T_old in enumerate(augmentation.image_transforms):
            distorted = augmentation.distortions[camera](frame.images[camera].numpy())
            moved = transform_image(distorted, new_T_old, augmentation.fill)
            np.testing.assert_array_equal(loaded.images[camera], moved)
            expected = new_T_old @ frame.image_T_ego[camera].double().numpy()
            np.testing.assert_allclose(loaded.image_T_ego[camera], expected, rtol=1e-5, atol=1e-3)
        assert torch.equal(loaded.boxes, frame.boxes)
        assert torch.equal(loaded.maps, frame.maps)


def test_a_mirrored_clip_has_mirrored_boxes_and_maps():
    number, _ = augmentation_where(lambda augmentation: augmentation.mirrored)
    for loaded, frame in zip(load(BOTH, number), synthetic_training_frames(1, 2), strict=True):
        torch.testing.assert_close(loaded.boxes, frame.boxes * torch.tensor([1.0, -1, 1, 1, 1, 1, -1, 1, -1]))
        assert torch.equal(loaded.maps, frame.maps.flip(2))
        assert torch.equal(loaded.labels, frame.labels)


def test_clips_are_not_mirrored_if_the_range_is_not_symmetric():
    lower, upper = (-51.2, -40.0, -3.0), (51.2, 51.2, 5.0)
    config = replace(TINY, voxels=replace(TINY.voxels, lower_m=lower, upper_m=upper))
    assert not any(sample_augmentation(BOTH, config, number).mirrored for number in range(20))
    assert any(sample_augmentation(BOTH, TINY, number).mirrored for number in range(20))


def test_a_lost_camera_stays_black():
    frames = [replace(frame, images={**frame.images, "CAM_FRONT": None}) for frame in synthetic_frames(1, 2)]
    slot = list(frames[0].cameras).index("CAM_FRONT")
    (clip,) = load_clips(FixedClips((frames,)), TINY, preprocessing(TINY), range(1), 0, BOTH)
    assert not clip[0].camera_valid[slot]
    assert not clip[0].images[slot].any()
    assert clip[0].images[slot - 1].any()


@pytest.mark.parametrize("order", ["rgb", "bgr"])
def test_the_colour_around_an_image_is_the_mean_colour_in_bgr_order(order):
    config = replace(TINY, image=replace(TINY.image, colour_order=order, mean=(10.0, 20.0, 30.4)))
    fill = sample_augmentation(BOTH, config, 0).fill
    assert fill.tolist() == ([30, 20, 10] if order == "rgb" else [10, 20, 30])
