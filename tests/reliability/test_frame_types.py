"""Reliability rows T1, T3, T7 and T9: numbers, arrays and names of other types than a frame should have."""

from dataclasses import replace
from decimal import Decimal

import numpy as np
import pytest

from duospacenet.runtime.errors import InputError
from duospacenet.runtime.validation import check_frame
from tests.helpers.frame_changes import FRONT, extrinsics, image, intrinsics, pose, timestamp, with_element
from tests.helpers.streams import lose_cameras, with_camera

IMAGE = r"camera CAM_FRONT: expected an image of uint8 \(64, 160, 3\) .*; got "
TIME = "timestamp_s: expected seconds as a float or an integer; got "
SIZE = "camera CAM_FRONT: expected width_px and height_px as integers of at least 1; got "
MATRIX_FIELDS = {
    "camera CAM_FRONT: intrinsics_px": intrinsics,
    "camera CAM_FRONT: camera_T_ego": extrinsics,
    "global_T_ego": pose,
}
MATRICES = {
    "float16": (lambda m: m.astype(np.float16), "float16"),
    "long double": (lambda m: m.astype(np.longdouble), "float128"),
    "complex": (lambda m: m.astype(np.complex64), "complex64"),
    "bool": (lambda m: m > 0, "bool"),
    "text": (lambda m: m.astype("U9"), "<U9"),
    "object": (lambda m: m.astype(object), "object"),
    "date": (lambda m: m.astype("datetime64[s]"), r"datetime64\[s\]"),
    "time difference": (lambda m: m.astype("timedelta64[s]"), r"timedelta64\[s\]"),
    "record": (lambda m: m.astype([("a", float)]), r"\[\('a', '<f8'\)\]"),
    "masked": (lambda m: np.ma.masked_array(m, m > 1e9), "a MaskedArray of float64"),
    "np.matrix": (np.matrix, "a matrix of float64"),
}
TIMES = {
    "complex": (complex, r"\("),
    "complex128": (np.complex128, r"np\.complex128"),
    "bool": (bool, "True"),
    "np.bool": (np.bool_, r"np\.True_"),
    "text": (str, "'15"),
    "Decimal": (lambda s: Decimal("1.5"), r"Decimal\('1\.5'\)"),
    "time difference": (lambda s: np.timedelta64(5, "s"), r"np\.timedelta64\(5"),
    "date": (lambda s: np.datetime64("2018-08-01T15:16:43"), r"np\.datetime64"),
    "float16": (np.float16, r"np\.float16"),
    "array": (np.array, r"array\("),
    "masked": (lambda s: np.ma.masked, "masked"),
}
IMAGES = {
    "masked": (np.ma.masked_array, r"a MaskedArray of uint8 \(64, 160, 3\)"),
    "bool": (lambda i: i > 0, "bool"),
    "object": (lambda i: i.astype(object), "object"),
    "text": (lambda i: i.astype("S3"), r"\|S3"),
    "float16": (lambda i: i.astype(np.float16), "float16"),
    "another library": (lambda i: Decimal(1), r"decimal\.Decimal"),
}
SIZES = {
    "bool": (True, "True, 64"),
    "float": (160.0, "160.0, 64"),
    "time difference": (np.timedelta64(160), "np.timede"),
}
NAMES = {
    "a lone surrogate": ("CAM\ud800", r"'CAM\\ud800'"),
    "an escape sequence": ("\x1b[31m", r"'\\x1b\[31m'"),
    "an escape sequence of one byte": ("\x9b2J", r"'\\x9b2J'"),
    "a line end": ("a\nb", r"'a\\nb'"),
    "NUL": ("a\0", r"'a\\x00'"),
    "reversed text": ("\u202egnp", r"'\\u202egnp'"),
    "a number": (1, "1"),
    "None": (None, "None"),
    "bytes": (b"CAM", "b'CAM'"),
}


@pytest.fixture(scope="module")
def frame(frames):
    return frames[0]


@pytest.mark.parametrize("field", MATRIX_FIELDS)
@pytest.mark.parametrize("kind", MATRICES)
def test_t1_a_matrix_of_another_type_is_refused_by_name(frame, field, kind):
    convert, got = MATRICES[kind]
    with pytest.raises(
        InputError, match=rf"^{field}: expected a \dx\d matrix of float64, float32 or integers; got {got}"
    ):
        check_frame(MATRIX_FIELDS[field](convert)(frame), 6)


@pytest.mark.parametrize("kind", TIMES)
def test_t1_a_time_stamp_of_another_type_is_refused(frame, kind):
    convert, got = TIMES[kind]
    with pytest.raises(InputError, match=TIME + got):
        check_frame(timestamp(convert)(frame), 6)


@pytest.mark.parametrize("kind", IMAGES)
def test_t1_an_image_of_another_type_is_refused(frame, kind):
    convert, got = IMAGES[kind]
    with pytest.raises(InputError, match=IMAGE + got):
        check_frame(image(convert)(frame), 6)


@pytest.mark.parametrize("kind", SIZES)
def test_t1_an_image_size_of_another_type_is_refused(frame, kind):
    width, got = SIZES[kind]
    with pytest.raises(InputError, match=SIZE + got):
        check_frame(with_camera(lose_cameras(frame, FRONT), FRONT, width_px=width), 6)


def test_t1_lists_of_cameras_or_images_are_refused(frame):
    for field in ("cameras", "images"):
        with pytest.raises(InputError, match=f"{field}: expected a mapping from camera names; got list"):
            check_frame(replace(frame, **{field: list(getattr(frame, field).values())}), 6)


@pytest.mark.parametrize("kind", ["float32", "float64", ">f8", "int64", "uint8", "int8"])
def test_t1_usual_types_of_numbers_are_accepted_in_matrices(frame, kind):
    # Rows of integers: a camera that looks forward, with a focal length and a centre of whole pixels.
    looking_forward = [[0, -1, 0, 0], [0, 0, -1, 1], [1, 0, 0, 0], [0, 0, 0, 1]]
    if np.dtype(kind).kind == "u":
        looking_forward = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 2], [0, 0, 0, 1]]
    changes = {
        intrinsics: [[80, 0, 80], [0, 80, 32], [0, 0, 1]],
        extrinsics: looking_forward,
        pose: [[1, 0, 0, 100], [0, 1, 0, 50], [0, 0, 1, 0], [0, 0, 0, 1]],
    }
    for change, rows in changes.items():
        check_frame(change(lambda _, rows=rows: np.array(rows, kind))(frame), 6)


def test_t1_images_in_a_memory_map_are_accepted(frame, tmp_path):
    np.save(tmp_path / "image.npy", frame.images[FRONT])
    check_frame(image(lambda _: np.load(tmp_path / "image.npy", mmap_mode="r"))(frame), 6)


@pytest.mark.parametrize(
    ("value", "precision"),
    [(np.float32(1533151603.5), "128"), (np.float32(2**24), "2"), (np.float32(20_000), "0.00195312")],
)
def test_t7_a_time_stamp_that_lost_its_digits_in_float32_is_refused(frame, value, precision):
    with pytest.raises(InputError, match=f"precision of 1 ms; got .*, whose precision is {precision} s. Use float64"):
        check_frame(timestamp(lambda _: value)(frame), 6)


@pytest.mark.parametrize("value", [np.float32(0.5), np.float32(-16_000), np.float64(1533151603.547), np.uint8(7)])
def test_t7_a_time_stamp_that_is_exact_to_a_millisecond_is_accepted(frame, value):
    check_frame(timestamp(lambda _: value)(frame), 6)


def test_t7_a_position_that_lost_its_digits_in_float32_is_refused(frame):
    def pose_at(northing_m, dtype):
        return pose(lambda p: with_element(1, 3, northing_m)(p).astype(dtype))(frame)

    with pytest.raises(InputError, match=r"global_T_ego: expected a position with .* whose precision is 0\.5 m"):
        check_frame(pose_at(5.3e6, np.float32), 6)
    check_frame(pose_at(5.3e6, np.float64), 6)
    check_frame(pose_at(4_000, np.float32), 6)


@pytest.mark.parametrize("kind", NAMES)
@pytest.mark.parametrize("field", ["cameras", "images", "scene", "token"])
def test_t9_a_name_that_cannot_be_printed_or_stored_is_refused(frame, field, kind):
    """OpenCV crashes if it draws a lone surrogate. A terminal executes escape sequences."""
    name, got = NAMES[kind]
    if field in ("cameras", "images"):
        changed = replace(frame, **{field: {**getattr(frame, field), name: getattr(frame, field)[FRONT]}})
        place = f"{field}: name of a camera"
    else:
        changed, place = replace(frame, **{field: name}), field
    with pytest.raises(InputError, match=f"^{place}: expected text without control characters; got {got}") as refusal:
        check_frame(changed, 7)
    assert str(refusal.value).isprintable()


def test_t9_names_in_any_script_are_accepted(frame):
    for name in ("", "größe", "前方カメラ", "/sensor/[front]", "🚗", "می\u200cخواهم"):
        check_frame(replace(frame, scene=name, token=name), 6)
