"""Reliability rows T1 to T4, T7 and T8: invalid frames, unusual but valid frames, and outputs that are not finite.

T5 is in test_image_files.py, T6 in test_parity_faults.py.
"""

from dataclasses import replace

import numpy as np
import pytest

from duospacenet.data.scene_folder import SceneFolder
from duospacenet.data.scene_writer import write_scene
from duospacenet.jobs.inference import run_stream
from duospacenet.runtime import Pipeline
from duospacenet.runtime.errors import InputError
from duospacenet.runtime.session import to_tensors
from duospacenet.runtime.validation import check_frame
from duospacenet.synthetic.drive import SyntheticDrive
from examples.nuscenes_scene import has_data, load_frames
from tests.helpers.frame_changes import FRONT, extrinsics, image, intrinsics, pose, timestamp, with_element
from tests.helpers.output_files import parse_strict_json
from tests.helpers.streams import bitwise_equal, detect_all, lose_cameras, record_sessions, with_camera


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
INVALID_FRAMES = {
    "an image of too few rows": (image(lambda i: i[:-1]), IMAGE + r".* got uint8 \(63, 160, 3\)"),
    "a transposed image": (image(lambda i: i.swapaxes(0, 1)), IMAGE + r".* got uint8 \(160, 64, 3\)"),
    "channels first": (image(lambda i: np.moveaxis(i, 2, 0)), IMAGE + r".* got uint8 \(3, 64, 160\)"),
    "a grey image": (image(lambda i: i[..., 0]), IMAGE + r".* got uint8 \(64, 160\)"),
    "an image with alpha": (image(lambda i: np.dstack([i, i[..., 0]])), IMAGE + r".* got uint8 \(64, 160, 4\)"),
    "a batch of images": (image(lambda i: i[None]), IMAGE + r".* got uint8 \(1, 64, 160, 3\)"),
    "a float image": (image(lambda i: i / np.float32(255)), IMAGE + r".* got float32"),
    "a 16-bit image": (image(lambda i: i.astype(np.uint16)), IMAGE + r".* got uint16"),
    "a signed image": (image(lambda i: i.astype(np.int8)), IMAGE + r".* got int8"),
    "an image as a list": (image(lambda i: i.tolist()), IMAGE + r".* got list"),
    "an empty image": (image(lambda i: i[:0]), IMAGE + r".* got uint8 \(0, 160, 3\)"),
    "neither an image nor None": (without_image, "camera CAM_FRONT: expected an image, or None .* got neither"),
    "an image of an unknown camera": (with_unknown_image, "camera CAM_ROOF: expected one of the calibrated cameras"),
    "a seventh camera": (with_seventh_camera, "cameras: expected 1 to 6.* got 7"),
    "no cameras": (lambda f: replace(f, images={}, cameras={}), "cameras: expected 1 to 6.* got 0"),
    "a width of zero": (
        lambda f: with_camera(lose_cameras(f, FRONT), FRONT, width_px=0),
        "camera CAM_FRONT: expected width_px and height_px as integers of at least 1; got 0, 64",
    ),
    "NaN in the intrinsics": (intrinsics(with_element(0, 2, np.nan)), INTRINSICS + " finite numbers, .* got .*nan"),
    "an infinite focal length": (intrinsics(with_element(0, 0, np.inf)), INTRINSICS + " finite numbers, .* got .*inf"),
    "transposed intrinsics": (intrinsics(np.transpose), INTRINSICS + r" \[\[fx.* transposed\?"),
    "a negative focal length": (intrinsics(with_element(1, 1, -100.0)), INTRINSICS + r".* positive focal lengths"),
    "a focal length of zero": (intrinsics(with_element(0, 0, 0.0)), INTRINSICS + r".* positive focal lengths"),
    "intrinsics of scale two": (intrinsics(lambda k: 2 * k), INTRINSICS + r" \[\[fx"),
    "intrinsics of 3x4": (intrinsics(lambda k: np.eye(3, 4)), INTRINSICS + r" a 3x3 matrix.* got float64 \(3, 4\)"),
    "intrinsics as a list": (intrinsics(lambda k: k.tolist()), INTRINSICS + r" a 3x3 matrix.* got list"),
    "intrinsics as text": (intrinsics(lambda k: k.astype(str)), INTRINSICS + r" a 3x3 matrix.* got <U"),
    "complex intrinsics": (intrinsics(lambda k: k + 0j), INTRINSICS + r" a 3x3 matrix.* got complex128"),
    "no intrinsics": (intrinsics(lambda k: None), INTRINSICS + r" a 3x3 matrix.* got NoneType"),
    "NaN in the extrinsics": (extrinsics(with_element(1, 3, np.nan)), EXTRINSICS + " finite numbers"),
    "transposed extrinsics": (extrinsics(np.transpose), EXTRINSICS + r" the last row 0 0 0 1.* transposed\?"),
    "scaled extrinsics": (extrinsics(lambda m: m @ np.diag([1.1, 1.1, 1.1, 1])), EXTRINSICS + " a rotation.* off by"),
    "mirrored extrinsics": (extrinsics(lambda m: m @ MIRROR), EXTRINSICS + " a rotation.* determinant -1"),
    "extrinsics of 3x4": (extrinsics(lambda m: m[:3]), EXTRINSICS + r" a 4x4 matrix.* got float64 \(3, 4\)"),
    "NaN in the pose": (pose(with_element(0, 3, np.nan)), "global_T_ego: expected finite numbers"),
    "an infinite pose": (pose(with_element(2, 3, -np.inf)), "global_T_ego: expected finite numbers"),
    "a pose of zeros": (pose(np.zeros_like), "global_T_ego: expected a rotation"),
    "a transposed pose": (pose(np.transpose), "global_T_ego: expected the last row 0 0 0 1"),
    "a pose of 16 numbers": (pose(np.ravel), r"global_T_ego: expected a 4x4 matrix.* got float64 \(16,\)"),
    "a time stamp of NaN": (timestamp(lambda s: np.nan), "timestamp_s: expected seconds, at most .*; got nan"),
    "an infinite time stamp": (timestamp(lambda s: np.inf), "timestamp_s: expected seconds, at most .*; got inf"),
    "a time stamp as text": (timestamp(str), "timestamp_s: expected seconds as a float or an integer; got '15"),
    "no time stamp": (timestamp(lambda s: None), "timestamp_s: expected seconds as a float or an integer; got None"),
    "a boolean as time stamp": (timestamp(lambda s: True), "timestamp_s: expected seconds as a float .*; got True"),
}


@pytest.mark.parametrize("case", INVALID_FRAMES)
def test_t1_an_invalid_frame_is_refused_and_does_not_change_the_history(pipeline, frames, valid_results, case):
    invalidate, message = INVALID_FRAMES[case]
    stream = pipeline.stream()
    with pytest.raises(InputError, match=message):
        stream.step(invalidate(frames[0]))
    assert bitwise_equal(stream.step(frames[0]), valid_results[0])
    with pytest.raises(InputError, match=message):
        stream.step(invalidate(frames[1]))
    assert bitwise_equal(stream.step(frames[1]), valid_results[1])


@pytest.fixture(scope="module")
def valid_results(pipeline, frames):
    return detect_all(pipeline, frames[:2])


# Finite values that no real rig has.
IMPLAUSIBLE_FRAMES = {
    "a focal length of 1e30": (intrinsics(with_element(0, 0, 1e30)), "camera CAM_FRONT: intrinsics_px"),
    "a principal point of 1e30": (intrinsics(with_element(0, 2, 1e30)), "camera CAM_FRONT: intrinsics_px"),
    "a camera 1e30 m away": (extrinsics(with_element(0, 3, 1e30)), "camera CAM_FRONT: camera_T_ego"),
    "a pose of 1e30 m": (pose(with_element(0, 3, 1e30)), "global_T_ego"),
    "a time stamp of 1e30 s": (timestamp(lambda s: 1e30), "timestamp_s"),
    "a time stamp too large for float64": (timestamp(lambda s: 10**400), "timestamp_s"),
    "a width as text": (lambda f: with_camera(lose_cameras(f, FRONT), FRONT, width_px="160"), "camera CAM_FRONT"),
    "a width of NaN": (lambda f: with_camera(lose_cameras(f, FRONT), FRONT, width_px=np.nan), "camera CAM_FRONT"),
}


@pytest.mark.parametrize("case", IMPLAUSIBLE_FRAMES)
def test_t3_an_implausible_number_is_refused(pipeline, frames, case):
    change, message = IMPLAUSIBLE_FRAMES[case]
    with pytest.raises(InputError, match=message):
        pipeline.stream().step(change(frames[0]))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e30, -1e30])
def test_t3_every_element_of_a_calibration_and_a_pose_must_be_finite_and_plausible(frames, value):
    fields = [(intrinsics, 3, 3, "CAM_FRONT: intrinsics_px"), (extrinsics, 4, 4, "CAM_FRONT: camera_T_ego")]
    for change, rows, columns, field in [*fields, (pose, 4, 4, "global_T_ego")]:
        for row, column in np.ndindex(rows, columns):
            with pytest.raises(InputError, match=f"{field}: expected finite numbers"):
                check_frame(change(with_element(row, column, value))(frames[0]), 6)


def test_t4_a_rotation_may_have_rounding_errors_only(frames):
    rng = np.random.default_rng(0)
    rounded = extrinsics(lambda m: m.astype(np.float32).astype(np.float64))
    check_frame(rounded(frames[0]), 6)
    for row, column in np.ndindex(3, 3):
        error = 0.01 * (1 + rng.random())
        with pytest.raises(InputError, match=EXTRINSICS):
            check_frame(
                extrinsics(lambda m, at=(row, column), error=error: with_element(*at, m[at] + error)(m))(frames[0]), 6
            )


@pytest.mark.parametrize("value", [5, 1.53e9, np.float64(3.5), np.int64(1_530_000_000), -2.0])
def test_t3_any_finite_number_type_is_accepted_as_a_time_stamp(frames, value):
    check_frame(replace(frames[0], timestamp_s=value), 6)


def test_t4_a_rig_of_one_camera_with_skew_is_accepted(frames):
    frame = intrinsics(with_element(0, 1, 0.5))(frames[0])
    check_frame(replace(frame, images={FRONT: frame.images[FRONT]}, cameras={FRONT: frame.cameras[FRONT]}), 6)


@pytest.mark.skipif(not has_data(), reason="the nuScenes frames are not beside this checkout")
def test_t4_real_calibrations_are_accepted():
    for frame in load_frames():
        check_frame(frame, 6)


# Intrinsics that a pinhole camera with images of 160x64 px cannot have, by the probable mistake.
ODD_INTRINSICS = {
    "normalised to 0..1": [[0.79, 0, 0.5], [0, 1.98, 0.5], [0, 0, 1]],
    "in millimetres": [[5.5, 0, 3.2], [0, 5.5, 1.3], [0, 0, 1]],
    "in metres": [[0.0055, 0, 0.0032], [0, 0.0055, 0.0013], [0, 0, 1]],
    "of a telescope": [[1e5, 0, 80], [0, 1e5, 32], [0, 0, 1]],
    "of an image of 4000 px": [[3165, 0, 2000], [0, 3165, 800], [0, 0, 1]],
    "with the principal point far to the left": [[126, 0, -900], [0, 126, 32], [0, 0, 1]],
}


@pytest.mark.parametrize("mistake", ODD_INTRINSICS)
def test_t4_intrinsics_that_no_pinhole_camera_has_are_refused(frames, mistake):
    with pytest.raises(
        InputError, match=r"CAM_FRONT: intrinsics_px: expected a focal length.* Are they in pixels of this"
    ):
        check_frame(intrinsics(lambda _: np.array(ODD_INTRINSICS[mistake], float))(frames[0]), 6)


@pytest.mark.parametrize("field_of_view_deg", [5, 30, 70, 120, 150])
@pytest.mark.parametrize("centre", [0.5, 0.1, -0.3, 1.4])
def test_t4_usual_lenses_and_cropped_images_are_accepted(frames, field_of_view_deg, centre):
    focal_px = 80 / np.tan(np.radians(field_of_view_deg) / 2)
    lens = np.array([[focal_px, 0, 160 * centre], [0, focal_px, 64 * centre], [0, 0, 1]])
    check_frame(intrinsics(lambda _: lens)(frames[0]), 6)


# --- T2: big-endian, non-contiguous, read-only arrays -------------------------------------------------------------


def strided(array):
    """Return a view of every second element of an array twice as large in each direction."""
    wide = np.zeros([2 * size for size in array.shape], array.dtype)
    view = wide[tuple(slice(None, None, 2) for _ in array.shape)]
    view[...] = array
    return view


def read_only(array):
    array = array.copy()
    array.setflags(write=False)
    return array


LAYOUTS = {
    "big-endian": lambda array: array.astype(array.dtype.newbyteorder(">")),
    "strided": strided,
    "column-major": np.asfortranarray,
    "negative strides": lambda array: array[::-1].copy()[::-1],
    "read-only": read_only,
}


@pytest.fixture(scope="module")
def large_frames():
    """Frames that are resized and cropped by the preprocessing."""
    return list(SyntheticDrive(3, frames=2, image_size=(320, 180)))


@pytest.mark.parametrize("layout", LAYOUTS)
def test_t2_detections_do_not_depend_on_the_memory_layout_of_arrays(pipeline, large_frames, layout):
    convert = LAYOUTS[layout]
    frames = [
        replace(
            frame,
            images={name: convert(image) for name, image in frame.images.items()},
            cameras={
                name: replace(c, intrinsics_px=convert(c.intrinsics_px), camera_T_ego=convert(c.camera_T_ego))
                for name, c in frame.cameras.items()
            },
            global_T_ego=convert(frame.global_T_ego),
        )
        for frame in large_frames
    ]
    results = zip(detect_all(pipeline, frames), detect_all(pipeline, large_frames), strict=True)
    assert all(bitwise_equal(a, b) for a, b in results)


# --- T7: large coordinates and times ------------------------------------------------------------------------------


def largest_difference(one, other):
    """Return the largest difference of any box number or score, over boxes of the same query and class."""
    rows = [
        dict(zip(zip(d.queries, d.classes, strict=True), np.column_stack([d.boxes, d.scores]), strict=True))
        for d in (one, other)
    ]
    common = rows[0].keys() & rows[1].keys()
    assert len(common) >= 299  # boxes with equal scores at the limit of 320 may differ
    difference = np.array([rows[0][key] - rows[1][key] for key in common], dtype=np.float64)
    difference[:, 6] = np.angle(np.exp(1j * difference[:, 6]))
    return np.abs(difference).max()


def test_t7_detections_do_not_depend_on_the_global_position(pipeline, frames):
    """float64 numbers near 5e6 m are 1e-9 m apart, far less than the tolerance."""
    offset = np.zeros((4, 4))
    offset[:3, 3] = 5e6
    far = [replace(frame, global_T_ego=frame.global_T_ego + offset) for frame in frames]
    results = zip(detect_all(pipeline, far), detect_all(pipeline, frames), strict=True)
    assert max(largest_difference(a, b) for a, b in results) < 1e-4


def test_t7_detections_do_not_depend_on_the_absolute_time(pipeline, frames):
    """float64 time stamps near 2.5e9 s are 5e-7 s apart. At 100 m/s that is 5e-5 m, less than the tolerance."""
    late = [replace(frame, timestamp_s=frame.timestamp_s + 1e9) for frame in frames]
    results = zip(detect_all(pipeline, late), detect_all(pipeline, frames), strict=True)
    assert max(largest_difference(a, b) for a, b in results) < 1e-4


# --- T8: outputs that are not finite ------------------------------------------------------------------------------


def test_t8_numbers_that_are_not_finite_are_dropped_and_counted(pipeline, frames):
    def with_nonfinite_outputs(outputs):
        logits, boxes = outputs["class_logits"].numpy().copy(), outputs["boxes"].numpy().copy()
        logits[3, 0], logits[5, 1], boxes[7, 8] = np.nan, np.inf, -np.inf
        return to_tensors(class_logits=logits, boxes=boxes)

    broken, _ = record_sessions(pipeline, decoder=with_nonfinite_outputs)
    (result,), (expected,) = detect_all(broken, frames[:1]), detect_all(pipeline, frames[:1])
    assert (result.dropped_queries, result.degraded) == (3, True)
    assert not set(result.queries.tolist()) & {3, 5, 7}
    assert np.isfinite(result.boxes).all()
    assert np.isfinite(result.scores).all()
    rest = ~np.isin(expected.queries, [3, 5, 7])
    assert np.array_equal(result.boxes[: rest.sum()], expected.boxes[rest])
    assert (expected.dropped_queries, expected.degraded) == (0, False)


def test_t8_a_frame_without_any_finite_output_gives_no_detections(pipeline, frames):
    def with_nonfinite_outputs(outputs):
        return {name: to_tensors(x=np.full(value.shape(), np.nan, np.float32))["x"] for name, value in outputs.items()}

    broken, _ = record_sessions(pipeline, decoder=with_nonfinite_outputs)
    (result,) = detect_all(broken, frames[:1])
    assert len(result) == len(result.classes) == 0
    assert result.dropped_queries == 32
    assert result.boxes.shape == (0, 9)


def test_t8_map_cells_that_are_not_finite_are_zero_and_counted(pipeline, frames):
    class BrokenSegmenter:
        def run(self, features):
            masks = pipeline.sessions["segmenter"].run(features)
            changed = {name: mask.numpy().copy() for name, mask in masks.items()}
            changed["drivable_area"][0, 0, 3, 4] = np.nan
            return to_tensors(**changed)

    broken = Pipeline(pipeline.manifest, {**pipeline.sessions, "segmenter": BrokenSegmenter()})
    result = broken.stream(maps=True).step(frames[0])
    assert (result.dropped_map_cells, result.degraded) == (1, True)
    assert result.maps["drivable_area"][3, 4] == 0
    assert np.isfinite(result.maps["drivable_area"]).all()


def test_t8_result_files_are_strict_json_if_the_decoder_outputs_nan(pipeline, frames, tmp_path):
    def with_nonfinite_outputs(outputs):
        logits, boxes = outputs["class_logits"].numpy().copy(), outputs["boxes"].numpy().copy()
        logits[::2], boxes[1] = np.nan, np.inf
        return to_tensors(class_logits=logits, boxes=boxes)

    broken, _ = record_sessions(pipeline, decoder=with_nonfinite_outputs)
    write_scene(tmp_path / "scene", frames[:2])
    (tmp_path / "out").mkdir()
    source = SceneFolder(tmp_path / "scene")
    summary = run_stream(broken, broken.stream(), source, tmp_path / "out", formats=("jsonl", "nuscenes"))
    lines = (tmp_path / "out" / "results.jsonl").read_text().splitlines()
    assert [parse_strict_json(line)["degraded"] for line in lines] == [True, True]
    assert [parse_strict_json(line)["dropped"]["queries"] for line in lines] == [17, 17]
    assert parse_strict_json((tmp_path / "out" / "results_nusc.json").read_text())["results"].keys() == {
        frame.token for frame in frames[:2]
    }
    assert summary.degraded == 2
