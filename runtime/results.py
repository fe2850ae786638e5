"""Result files: JSON Lines, one frame a line; and the nuScenes submission."""

import json
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from .detections import Detections
from .errors import InputError, OutputError
from .files import write_atomically
from .frame import Frame
from .geometry import rotation_z
from .images import write_png

_MOVING_M_S = 0.2  # slower than this, an object is taken to stand


class JsonLines:
    """`results.jsonl`: what is written is whole lines, one a frame, and stays when the run is broken off."""

    def __init__(self, path: Path) -> None:
        """Raises OutputError when the file cannot be made."""
        self._path = path
        try:
            self._file = path.open("x", encoding="utf-8")
        except OSError as error:
            raise OutputError(f"cannot write {path}: {error.strerror}") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._file.close()

    def write(self, detections: Detections, masks: Mapping[str, str] | None = None) -> None:
        """Append one frame; `masks` are the files of its maps. Raises OutputError when it does not reach the file."""
        line = json.dumps(to_record(detections, masks or {}), allow_nan=False)
        try:
            self._file.write(line + "\n")
            self._file.flush()
        except OSError as error:
            raise OutputError(f"cannot write {self._path}: {error.strerror}") from error


def write_masks(out: Path, index: int, maps: Mapping[str, NDArray[np.float32]]) -> dict[str, str]:
    """Write probabilities (X, Y) as 8-bit PNG files, row i at x_i, column j at y_j; returns their paths in `out`."""
    paths = {name: f"maps/{index:06d}_{name}.png" for name in maps}
    for name, mask in maps.items():
        write_png(out / paths[name], np.rint(255 * mask).astype(np.uint8))
    return paths


def to_record(detections: Detections, masks: Mapping[str, str]) -> dict[str, Any]:
    """One frame as JSON values; boxes in the ego frame, best first; maps by the path of their file."""
    return {
        "scene": detections.scene,
        "token": detections.token,
        "timestamp_s": detections.timestamp_s,
        "history": {"frames": detections.history.frames, "reset_reason": detections.history.reset_reason},
        "degraded": detections.degraded,
        "dropped": {"queries": detections.dropped, "map_cells": detections.dropped_cells},
        "boxes": [
            {
                "class": name,
                "score": round(float(score), 6),
                "center_m": _rounded(box[:3]),
                "size_wlh_m": _rounded(box[3:6]),
                "yaw_rad": round(float(box[6]), 6),
                "velocity_m_s": _rounded(box[7:9]),
            }
            for box, score, name in zip(detections.boxes, detections.scores, detections.classes, strict=True)
        ],
        "maps": dict(masks),
        "timings_ms": {stage: round(1000 * seconds, 2) for stage, seconds in detections.timings_s.items()},
    }


class NuScenesSubmission:
    """The JSON that nuScenes' detection evaluation reads: global frame, at most 500 boxes a sample, attributes."""

    def __init__(self) -> None:
        self._results: dict[str, list[dict[str, Any]]] = {}

    def add(self, frame: Frame, detections: Detections) -> None:
        """Add one sample. Raises InputError for a frame without a token of its own: the samples are known by it."""
        if not frame.token or frame.token in self._results:
            got = f"{frame.token!r} for the second time" if frame.token else "none"
            raise InputError(
                f"frame at {frame.timestamp_s!r} s: expected a sample token for the nuScenes format; got {got}. "
                "Give every frame of the source its own."
            )
        self._results[frame.token] = [
            _submitted(frame, box, float(score), name)
            for box, score, name in zip(detections.boxes, detections.scores, detections.classes, strict=True)
        ]

    def write(self, path: Path) -> None:
        """Write the file, whole or not at all. Raises OutputError."""
        uses = {"use_camera": True, "use_lidar": False, "use_radar": False, "use_map": False, "use_external": False}
        text = json.dumps({"meta": uses, "results": self._results}, allow_nan=False)
        write_atomically(path, text.encode())


def attribute(name: str, speed_m_s: float) -> str:
    """The likeliest nuScenes attribute of an object of class `name`."""
    moves = speed_m_s > _MOVING_M_S
    if name in ("barrier", "traffic_cone"):
        return ""
    if name == "pedestrian":
        return "pedestrian.moving" if moves else "pedestrian.standing"
    if name in ("motorcycle", "bicycle"):
        return "cycle.with_rider" if moves else "cycle.without_rider"
    if name == "bus" and not moves:
        return "vehicle.stopped"
    return "vehicle.moving" if moves else "vehicle.parked"


def _submitted(frame: Frame, box: NDArray[np.float32], score: float, name: str) -> dict[str, Any]:
    global_R_ego = frame.global_T_ego[:3, :3]
    center = global_R_ego @ box[:3] + frame.global_T_ego[:3, 3]
    velocity = global_R_ego @ np.array([box[7], box[8], 0.0])
    return {
        "sample_token": frame.token,
        "translation": center.tolist(),
        "size": box[3:6].tolist(),
        "rotation": quaternion(global_R_ego @ rotation_z(float(box[6]))),
        "velocity": velocity[:2].tolist(),
        "detection_name": name,
        "detection_score": score,
        "attribute_name": attribute(name, float(np.hypot(box[7], box[8]))),
    }


def quaternion(rotation: NDArray[np.float64]) -> list[float]:
    """The unit quaternion, w first and not negative, of a rotation (3, 3)."""
    vector, _ = cv2.Rodrigues(rotation)
    angle = float(np.linalg.norm(vector))
    axis = vector[:, 0] / angle if angle else np.zeros(3)
    return [float(np.cos(angle / 2)), *(np.sin(angle / 2) * axis).tolist()]


def _rounded(values: NDArray[np.float32]) -> list[float]:
    return [round(float(value), 4) for value in values]
