from dataclasses import replace

import numpy as np
import pytest
from driving import drive, lose, same_bits, with_camera
from nuscenes_scene import is_here, load_frames

from duospacenet.runtime.errors import InputError
from duospacenet.runtime.validation import check_frame

FRONT = "CAM_FRONT"


def image(change):
    return lambda frame: replace(frame, images={**frame.images, FRONT: change(frame.images[FRONT])})


def intrinsics(change):
    return lambda frame: with_camera(frame, FRONT, intrinsics_px=change(frame.cameras[FRONT].intrinsics_px))


def extrinsics(change):
    return lambda frame: with_camera(frame, FRONT, camera_T_ego=change(frame.cameras[FRONT].camera_T_ego))


def pose(change):
    return lambda frame: replace(frame, global_T_ego=change(frame.global_T_ego))


def stamp(change):
    return lambda frame: replace(frame, timestamp_s=change(frame.timestamp_s))


def put(row, column, value):
    def change(matrix):
        matrix = matrix.copy()
        matrix[row, column] = value
        return matrix

    return change


def without_image(frame):
    return replace(frame, images={name: image for name, image in frame.images.items() if name != FRONT})


def with_unknown_image(frame):
    return replace(frame, images={**frame.images, "CAM_ROOF": frame.images[FRONT]})


def with_seventh_camera(frame):
    return replace(
        frame,
        images={**frame.images, "CAM_ROOF": frame.images[FRONT]},
        cameras={**frame.cameras, "CAM_ROOF": frame.cameras[FRONT]},
    )


IMAGE = r"camera CAM_FRONT: expected an image of uint8 \(64, 160, 3\)"
INTRINSICS = "camera CAM_FRONT: intrinsics_px: expected"
EXTRINSICS = "camera CAM_FRONT: camera_T_ego: expected"
MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])
BAD_FRAMES = {
    "an image of too few rows": (image(lambda i: i[:-1]), IMAGE + r".* got uint8 \(63, 160, 3\)"),
    "an image on its side": (image(lambda i: i.swapaxes(0, 1)), IMAGE + r".* got uint8 \(160, 64, 3\)"),
    "channels first": (image(lambda i: np.moveaxis(i, 2, 0)), IMAGE + r".* got uint8 \(3, 64, 160\)"),
    "a grey image": (image(lambda i: i[..., 0]), IMAGE + r".* got uint8 \(64, 160\)"),
    "an image with alpha": (image(lambda i: np.dstack([i, i[..., 0]])), IMAGE + r".* got uint8 \(64, 160, 4\)"),
    "a batch of images": (image(lambda i: i[None]), IMAGE + r".* got uint8 \(1, 64, 160, 3\)"),
    "a float image": (image(lambda i: i / np.float32(255)), IMAGE + r".* got float32"),
    "a 16-bit image": (image(lambda i: i.astype(np.uint16)), IMAGE + r".* got uint16"),
    "a signed image": (image(lambda i: i.astype(np.int8)), IMAGE + r".* got int8"),
    "an image as a list": (image(lambda i: i.tolist()), IMAGE + r".* got list"),
    "an empty image": (image(lambda i: i[:0]), IMAGE + r".* got uint8 \(0, 160, 3\)"),
    "no image and no None": (without_image, "camera CAM_FRONT: expected an image, or None .* got neither"),
    "an image of an unknown camera": (with_unknown_image, "camera CAM_ROOF: expected one of the calibrated cameras"),
    "a seventh camera": (with_seventh_camera, "cameras: expected 1 to 6.* got 7"),
    "no cameras": (lambda f: replace(f, images={}, cameras={}), "cameras: expected 1 to 6.* got 0"),
    "a width of zero": (
        lambda f: with_camera(lose(f, FRONT), FRONT, width_px=0),
        "camera CAM_FRONT: expected width_px and height_px of at least 1; got 0, 64",
    ),
    "NaN in the intrinsics": (intrinsics(put(0, 2, np.nan)), INTRINSICS + " finite numbers, .* got .*nan"),
    "an infinite focal length": (intrinsics(put(0, 0, np.inf)), INTRINSICS + " finite numbers, .* got .*inf"),
    "transposed intrinsics": (intrinsics(np.transpose), INTRINSICS + r" \[\[fx.* transposed\?"),
    "a negative focal length": (intrinsics(put(1, 1, -100.0)), INTRINSICS + r".* positive focal lengths"),
    "a focal length of zero": (intrinsics(put(0, 0, 0.0)), INTRINSICS + r".* positive focal lengths"),
    "intrinsics of scale two": (intrinsics(lambda k: 2 * k), INTRINSICS + r" \[\[fx"),
    "intrinsics of 3x4": (intrinsics(lambda k: np.eye(3, 4)), INTRINSICS + r" a 3x3 matrix.* got float64 \(3, 4\)"),
    "intrinsics as a list": (intrinsics(lambda k: k.tolist()), INTRINSICS + r" a 3x3 matrix.* got list"),
    "intrinsics as text": (intrinsics(lambda k: k.astype(str)), INTRINSICS + r" a 3x3 matrix.* got <U"),
    "complex intrinsics": (intrinsics(lambda k: k + 0j), INTRINSICS + r" a 3x3 matrix.* got complex128"),
    "no intrinsics": (intrinsics(lambda k: None), INTRINSICS + r" a 3x3 matrix.* got NoneType"),
    "NaN in the extrinsics": (extrinsics(put(1, 3, np.nan)), EXTRINSICS + " finite numbers"),
    "transposed extrinsics": (extrinsics(np.transpose), EXTRINSICS + r" the last row 0 0 0 1.* transposed\?"),
    "scaled extrinsics": (extrinsics(lambda m: m @ np.diag([1.1, 1.1, 1.1, 1])), EXTRINSICS + " a rotation.* off by"),
    "mirrored extrinsics": (extrinsics(lambda m: m @ MIRROR), EXTRINSICS + " a rotation.* determinant -1"),
    "extrinsics of 3x4": (extrinsics(lambda m: m[:3]), EXTRINSICS + r" a 4x4 matrix.* got float64 \(3, 4\)"),
    "NaN in the pose": (pose(put(0, 3, np.nan)), "global_T_ego: expected finite numbers"),
    "an infinite pose": (pose(put(2, 3, -np.inf)), "global_T_ego: expected finite numbers"),
    "a pose of zeros": (pose(np.zeros_like), "global_T_ego: expected a rotation"),
    "a transposed pose": (pose(np.transpose), "global_T_ego: expected the last row 0 0 0 1"),
    "a pose of 16 numbers": (pose(np.ravel), r"global_T_ego: expected a 4x4 matrix.* got float64 \(16,\)"),
    "a time that is NaN": (stamp(lambda s: np.nan), "timestamp_s: expected seconds, at most .*; got nan"),
    "an infinite time": (stamp(lambda s: np.inf), "timestamp_s: expected seconds, at most .*; got inf"),
    "a time as text": (stamp(str), "timestamp_s: expected seconds, at most .*; got '15"),
    "no time": (stamp(lambda s: None), "timestamp_s: expected seconds, at most .*; got None"),
    "a time that is true": (stamp(lambda s: True), "timestamp_s: expected seconds, at most .*; got True"),
}


@pytest.mark.parametrize("bad", BAD_FRAMES)
def test_a_bad_frame_is_refused_by_name_and_changes_nothing(pipeline, frames, good_answers, bad):
    spoil, words = BAD_FRAMES[bad]
    stream = pipeline.stream()
    with pytest.raises(InputError, match=words):
        stream.step(spoil(frames[0]))
    assert same_bits(stream.step(frames[0]), good_answers[0])
    with pytest.raises(InputError, match=words):
        stream.step(spoil(frames[1]))
    assert same_bits(stream.step(frames[1]), good_answers[1])


@pytest.fixture(scope="module")
def good_answers(pipeline, frames):
    return drive(pipeline, frames[:2])


# Finite, and yet no rig delivers it.
IMPLAUSIBLE = {
    "a focal length of 1e30": (intrinsics(put(0, 0, 1e30)), "camera CAM_FRONT: intrinsics_px"),
    "a principal point of 1e30": (intrinsics(put(0, 2, 1e30)), "camera CAM_FRONT: intrinsics_px"),
    "a camera 1e30 m away": (extrinsics(put(0, 3, 1e30)), "camera CAM_FRONT: camera_T_ego"),
    "a pose of 1e30 m": (pose(put(0, 3, 1e30)), "global_T_ego"),
    "a time of 1e30 s": (stamp(lambda s: 1e30), "timestamp_s"),
    "a time that no float64 holds": (stamp(lambda s: 10**400), "timestamp_s"),
    "a width as text": (lambda f: with_camera(lose(f, FRONT), FRONT, width_px="160"), "camera CAM_FRONT"),
    "a width that is NaN": (lambda f: with_camera(lose(f, FRONT), FRONT, width_px=np.nan), "camera CAM_FRONT"),
}


@pytest.mark.parametrize("bad", IMPLAUSIBLE)
def test_a_number_that_no_rig_delivers_is_refused(pipeline, frames, bad):
    spoil, words = IMPLAUSIBLE[bad]
    with pytest.raises(InputError, match=words):
        pipeline.stream().step(spoil(frames[0]))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_every_single_number_of_a_calibration_and_a_pose_must_be_finite(frames, value):
    fields = [(intrinsics, 3, 3, "CAM_FRONT: intrinsics_px"), (extrinsics, 4, 4, "CAM_FRONT: camera_T_ego")]
    for change, rows, columns, words in [*fields, (pose, 4, 4, "global_T_ego")]:
        for row, column in np.ndindex(rows, columns):
            with pytest.raises(InputError, match=f"{words}: expected finite numbers"):
                check_frame(change(put(row, column, value))(frames[0]), 6)


def test_a_rotation_may_be_off_by_rounding_only(frames):
    rng = np.random.default_rng(0)
    rounded = extrinsics(lambda m: m.astype(np.float32).astype(np.float64))
    check_frame(rounded(frames[0]), 6)
    for row, column in np.ndindex(3, 3):
        off = 0.01 * (1 + rng.random())
        with pytest.raises(InputError, match=EXTRINSICS):
            check_frame(extrinsics(lambda m, at=(row, column), off=off: put(*at, m[at] + off)(m))(frames[0]), 6)


@pytest.mark.parametrize("value", [5, 1.53e9, np.float64(3.5), np.int64(1_530_000_000), -2.0])
def test_any_kind_of_finite_number_is_a_time(frames, value):
    check_frame(replace(frames[0], timestamp_s=value), 6)


def test_a_rig_of_one_camera_with_skewed_pixels_is_accepted(frames):
    frame = intrinsics(put(0, 1, 0.5))(frames[0])
    check_frame(replace(frame, images={FRONT: frame.images[FRONT]}, cameras={FRONT: frame.cameras[FRONT]}), 6)


@pytest.mark.skipif(not is_here(), reason="the nuScenes frames do not lie beside this checkout")
def test_real_calibrations_are_accepted():
    for frame in load_frames():
        check_frame(frame, 6)
