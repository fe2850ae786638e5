"""Faults of a stream: wrong inputs, a wrong history, or wrong results of correct graphs."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any
from unittest import mock

import cv2
import numpy as np

from duospacenet.runtime import Frame, history, pipeline, preprocessing
from duospacenet.runtime.geometry import image_T_ego, inverse

from .bench import Bench, Prepare

# ---------------------------------------------------------------------------------------------------------------------
# Frames


def in_frames(change: Callable[[Frame], Frame]) -> Callable[[Bench], None]:
    """A fault that changes every frame of the stream."""
    return lambda bench: bench.change_stream_frames(change)


def images_exchanged(frame: Frame) -> Frame:
    one, other, *_ = frame.images
    return replace(frame, images={**frame.images, one: frame.images[other], other: frame.images[one]})


def calibrations_mirrored(frame: Frame) -> Frame:
    return replace(frame, cameras=dict(zip(frame.cameras, reversed(frame.cameras.values()), strict=True)))


def rgb_for_bgr(frame: Frame) -> Frame:
    flipped = {name: None if image is None else image[..., ::-1].copy() for name, image in frame.images.items()}
    return replace(frame, images=flipped)


def extrinsic_transposed(frame: Frame) -> Frame:
    def transpose(camera_T_ego: np.ndarray) -> np.ndarray:
        transposed_rotation = camera_T_ego.copy()
        transposed_rotation[:3, :3] = camera_T_ego[:3, :3].T
        return transposed_rotation

    return _with_extrinsics(frame, transpose)


def extrinsic_inverted(frame: Frame) -> Frame:
    return _with_extrinsics(frame, inverse)


def pose_inverted(frame: Frame) -> Frame:
    return replace(frame, global_T_ego=inverse(frame.global_T_ego))


def lost_camera_as_black_image(frame: Frame) -> Frame:
    """A lost camera gets a black image, so that it counts as valid."""
    black = {name: np.zeros((camera.height_px, camera.width_px, 3), np.uint8) for name, camera in frame.cameras.items()}
    return replace(
        frame, images={name: black[name] if image is None else image for name, image in frame.images.items()}
    )


def images_one_frame_late(bench: Bench) -> None:
    last: dict[str, Any] = {}

    def delay(frame: Frame) -> Frame:
        images = last.get("images", frame.images)
        last["images"] = frame.images
        return replace(frame, images=images)

    bench.change_stream_frames(delay)


def _with_extrinsics(frame: Frame, change: Callable[[np.ndarray], np.ndarray]) -> Frame:
    cameras = {
        name: replace(camera, camera_T_ego=change(camera.camera_T_ego)) for name, camera in frame.cameras.items()
    }
    return replace(frame, cameras=cameras)


# ---------------------------------------------------------------------------------------------------------------------
# Preprocessing. Each function changes `prepare`, for the stream alone or for both sides.


def in_stream_preparation(broken: Callable[[Prepare], Prepare]) -> Callable[[Bench], None]:
    """A fault in the preprocessing of the stream alone."""
    return lambda bench: bench.change_stream_preparation(broken)


def intrinsics_without_crop(prepare: Prepare) -> Prepare:
    def broken(frame: Frame, settings: Any, num_cameras: int) -> preprocessing.NetworkInputs:
        inputs = prepare(frame, settings, num_cameras)
        for slot, camera in enumerate(frame.cameras.values()):
            scale = np.diag(np.diag(preprocessing.resize_transform(camera, settings)))
            inputs.image_T_ego[slot] = image_T_ego(scale @ camera.intrinsics_px, camera.camera_T_ego)
        return inputs

    return broken


def intrinsics_without_resize(prepare: Prepare) -> Prepare:
    def broken(frame: Frame, settings: Any, num_cameras: int) -> preprocessing.NetworkInputs:
        inputs = prepare(frame, settings, num_cameras)
        for slot, camera in enumerate(frame.cameras.values()):
            inputs.image_T_ego[slot] = image_T_ego(camera.intrinsics_px, camera.camera_T_ego)
        return inputs

    return broken


def another_resize_kernel(prepare: Prepare) -> Prepare:
    def broken(*arguments: Any) -> preprocessing.NetworkInputs:
        with mock.patch.object(preprocessing.cv2, "INTER_AREA", cv2.INTER_CUBIC):
            return prepare(*arguments)

    return broken


def lost_cameras_marked_valid(prepare: Prepare) -> Prepare:
    def broken(*arguments: Any) -> preprocessing.NetworkInputs:
        inputs = prepare(*arguments)
        return inputs._replace(camera_valid=np.ones_like(inputs.camera_valid))

    return broken


def colours_reversed(prepare: Prepare) -> Prepare:
    def broken(*arguments: Any) -> preprocessing.NetworkInputs:
        inputs = prepare(*arguments)
        return inputs._replace(images=inputs.images[..., ::-1].copy())

    return broken


def with_changed_frame(change: Callable[[Frame], Frame]) -> Callable[[Prepare], Prepare]:
    """Preprocessing of changed frames."""
    return lambda prepare: lambda frame, *arguments: prepare(change(frame), *arguments)


# ---------------------------------------------------------------------------------------------------------------------
# History


def in_window(**changes: Callable[[np.ndarray], np.ndarray]) -> Callable[[Bench], None]:
    """A fault that changes the decoder inputs computed by the history."""

    def inject(bench: Bench) -> None:
        to_tensors = history.to_tensors

        def broken(**arrays: np.ndarray) -> Any:
            changed = {name: np.ascontiguousarray(changes[name](arrays[name])) for name in changes}
            return to_tensors(**arrays | {name: value.astype(arrays[name].dtype) for name, value in changed.items()})

        bench.patch("to_tensors", broken, history)

    return inject


def times_one_slot_late(values: np.ndarray) -> np.ndarray:
    return values[[0, 0, 1, 2]]


def inverted(transforms: np.ndarray) -> np.ndarray:
    return np.linalg.inv(transforms)


def transposed(transforms: np.ndarray) -> np.ndarray:
    return transforms.swapaxes(1, 2)


def current_pose_moved(transforms: np.ndarray) -> np.ndarray:
    """The transform of the current slot is a translation by 30 cm instead of the identity."""
    moved = transforms.copy()
    moved[0, 0, 3] = 0.3
    return moved


def history_not_updated(bench: Bench) -> None:
    """The history keeps its first frame for ever."""
    after = history.History.after
    bench.patch("after", lambda self, now: self if self._past else after(self, now), history.History)


def cached_values_of_the_wrong_slot(bench: Bench) -> None:
    """Slots 1 and 2 exchange their cached values, but not their poses and times."""
    decoder_inputs = history.History.decoder_inputs

    def broken(self: history.History, *arguments: Any) -> Any:
        bound, size = decoder_inputs(self, *arguments)
        exchanged = {
            f"slot{3 - int(name[4])}{name[5:]}": bound[name] for name in bound if name[:5] in ("slot1", "slot2")
        }
        return bound | exchanged, size

    bench.patch("decoder_inputs", broken, history.History)


def history_never_reset(bench: Bench) -> None:
    bench.patch("reset_reason", lambda self, frame: None, history.History)


def history_always_reset(bench: Bench) -> None:
    bench.patch("reset_reason", lambda self, frame: "always" if self._past else None, history.History)


def tables_never_recomputed(bench: Bench) -> None:
    tables = pipeline.Stream._lifting_tables

    def broken(self: pipeline.Stream, inputs: preprocessing.NetworkInputs) -> Any:
        return self._tables or tables(self, inputs)

    bench.patch("_lifting_tables", broken, pipeline.Stream)


def current_calibration_for_all(values: np.ndarray) -> np.ndarray:
    return np.broadcast_to(values[:1], values.shape)


# ---------------------------------------------------------------------------------------------------------------------
# Results


def class_names_shifted(bench: Bench) -> None:
    select_detections = pipeline.select_detections

    def broken(*arguments: Any) -> Any:
        queries, labels, scores, dropped = select_detections(*arguments)
        return queries, (labels + 1) % 10, scores, dropped

    bench.patch("select_detections", broken, pipeline)


def best_boxes_missing(bench: Bench) -> None:
    select_detections = pipeline.select_detections
    bench.patch(
        "select_detections",
        lambda *arguments: (*(found[5:] for found in select_detections(*arguments)[:3]), 0),
        pipeline,
    )
