"""The results of a run: `results.jsonl` with one line per frame, and map masks as PNG files beside it."""

import json
import math
import mmap
import os
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Annotated, Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from ..runtime.detections import Detections
from ..runtime.errors import OutputError
from ..runtime.files import output_errors
from ..runtime.frame import Frame
from ..runtime.json_record import FiniteFloat, Flag, Integer, JsonRecord
from ..runtime.strict_json import parse_strict_json
from .images import write_png

FrameResult = dict[str, Any]  # one line as JSON values; its fields are those of `FrameResultSchema`
LARGEST = 3.5e38  # networks return float32; larger numbers overflow when boxes are drawn
Number = Annotated[float, Field(strict=True, ge=-LARGEST, le=LARGEST)]
PoseRow = tuple[Number, Number, Number, Number]
Size = Annotated[float, Field(strict=True, ge=0, le=LARGEST)]


class BoxResultSchema(JsonRecord):
    """One detection in the ego frame.

    class: one of the bundle's classes. score: from 0 to 1.
    center_m: x, y, z of the centre of the box. size_wlh_m: width, length and height; the length is along the heading.
    yaw_rad: 0 along x, counter-clockwise about z. velocity_m_s: vx, vy over ground.
    attribute: of nuScenes, or "" for a class without attributes.
    """

    name: str = Field(alias="class")
    score: Number
    center_m: tuple[Number, Number, Number]
    size_wlh_m: tuple[Size, Size, Size]
    yaw_rad: Number
    velocity_m_s: tuple[Number, Number]
    attribute: str


class HistorySchema(JsonRecord):
    """The history that a result is based on; the fields are those of `HistoryReport`.

    frames: number of frames that the decoder used, the current one included; 0 for a skipped frame.
    reset_reason: why the history was reset before this frame; None if it was continued.
    ages_s: age of each past frame that the decoder used [s], newest first. Added in version 0.3.0.
    """

    frames: Integer
    reset_reason: str | None
    ages_s: tuple[FiniteFloat, ...] = ()


class FrameResultSchema(JsonRecord):
    """One line of `results.jsonl`, the result of one frame.

    scene, token, timestamp_s: copied from the frame.
    global_T_ego: the ego pose of the frame, which converts boxes to the global frame.
    skipped: why the frame was skipped; None if it was processed.
    degraded: whether queries or map cells were dropped, because they had numbers that are not finite.
    dropped: their numbers, `queries` and `map_cells`.
    boxes: at most 500, highest score first.
    maps: path of the mask file by map class, relative to the folder of `results.jsonl`.
    """

    scene: str
    token: str
    timestamp_s: FiniteFloat
    global_T_ego: tuple[PoseRow, PoseRow, PoseRow, PoseRow]
    history: HistorySchema
    skipped: str | None
    degraded: Flag
    dropped: dict[str, Integer]
    boxes: tuple[BoxResultSchema, ...]
    maps: dict[str, str]


class ResultBoxes(NamedTuple):
    """The boxes of a frame's result, in its order.

    boxes: (D, 9) in the ego frame: x y z w l h [m], yaw [rad], vx vy [m/s].
    scores: (D,). classes, attributes: D names.
    """

    boxes: NDArray[np.float64]
    scores: NDArray[np.float64]
    classes: tuple[str, ...]
    attributes: tuple[str, ...]


class ResultsFile:
    """`results.jsonl`, open for appending. It contains only complete lines, also if the run is interrupted."""

    def __init__(self, path: Path) -> None:
        """Open a file, and create it if it does not exist. Raises OutputError if it cannot be opened."""
        self._path = path
        with output_errors(path):
            self._file = path.open("ab", buffering=0)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        with self._file:
            os.fsync(self._file.fileno())

    def write(self, result: FrameResult) -> None:
        """Append one frame. Raises OutputError if that fails, after removing any part of the line."""
        # The file is unbuffered, so that a line is usually one system call and a kill rarely leaves a partial line.
        line = memoryview((json.dumps(result, allow_nan=False) + "\n").encode())
        end = self._file.seek(0, os.SEEK_END)
        with output_errors(self._path):
            try:
                while line:
                    line = line[self._file.write(line) :]
            except OSError:
                with suppress(OSError):
                    self._file.truncate(end)
                raise


def drop_partial_line(path: Path) -> None:
    """Remove the partial line that a killed run may have left at the end of its results file."""
    if not path.exists() or path.stat().st_size == 0:
        return
    with path.open("rb+") as file:
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            end = content.rfind(b"\n") + 1
        file.truncate(end)


def read_results(path: Path) -> Iterator[FrameResult]:
    """Yield the frames of a results file in its order, or nothing if there is no file.

    Raises OutputError, naming the line, for a line that is not a frame's result.
    """
    if not path.exists():
        return
    with path.open("rb") as file:
        for number, line in enumerate(file, start=1):
            try:
                result = parse_strict_json(line)
                FrameResultSchema.model_validate(result)
            except ValueError:  # also JsonError and pydantic's ValidationError
                raise OutputError(
                    f"{path}: line {number}: expected a frame's results; got {line[:40]!r}. Start a new run."
                ) from None
            yield result


def result_boxes(result: FrameResult, min_score: float = -math.inf) -> ResultBoxes:
    """Return the boxes of a frame's result that have at least the score `min_score`, as arrays."""
    kept = [box for box in result["boxes"] if box["score"] >= min_score]
    rows = [(*box["center_m"], *box["size_wlh_m"], box["yaw_rad"], *box["velocity_m_s"]) for box in kept]
    return ResultBoxes(
        np.array(rows, np.float64).reshape(-1, 9),
        np.array([box["score"] for box in kept], np.float64),
        tuple(box["class"] for box in kept),
        tuple(box["attribute"] for box in kept),
    )


def write_masks(out: Path, index: int, maps: Mapping[str, NDArray[np.float32]]) -> dict[str, str]:
    """Write the map probabilities of frame `index` as 8-bit PNG files, 255 for a probability of 1.

    maps: (X, Y) by map class; row i of the file is x_i (forward), column j is y_j (left).

    Returns the path of each file, relative to the folder `out`.
    """
    paths = {name: f"maps/{index:06d}_{name}.png" for name in maps}
    for name, mask in maps.items():
        write_png(out / paths[name], np.rint(255 * mask).astype(np.uint8))
    return paths


def frame_result(frame: Frame, detections: Detections, masks: Mapping[str, str]) -> FrameResult:
    """Return the result of one frame as JSON values.

    Boxes are in the ego frame, highest score first; `global_T_ego` is the ego pose for converting them.
    masks: path of the mask file by map class.

    Timings are left out, so that a second run gives identical bytes.
    """
    return {
        "scene": detections.scene,
        "token": detections.token,
        "timestamp_s": detections.timestamp_s,
        "global_T_ego": np.asarray(frame.global_T_ego, dtype=np.float64).tolist(),
        "history": {
            "frames": detections.history.frames,
            "reset_reason": detections.history.reset_reason,
            "ages_s": [round(age_s, 6) for age_s in detections.history.ages_s],
        },
        "skipped": detections.skipped,
        "degraded": detections.degraded,
        "dropped": {"queries": detections.dropped_queries, "map_cells": detections.dropped_map_cells},
        "boxes": _box_results(detections),
        "maps": dict(masks),
    }


def rounded_boxes(detections: Detections) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the boxes (D, 9) and scores (D,) of detections as results store them.

    Positions, sizes and velocities have 4 decimals, yaws and scores 6. nuScenes' annotations have 3.
    """
    boxes = detections.boxes.astype(np.float64)
    rounded = np.round(boxes, 4)
    rounded[:, 6] = np.round(boxes[:, 6], 6)
    scores: NDArray[np.float64] = detections.scores.astype(np.float64)
    return rounded, scores.round(6)


def _box_results(detections: Detections) -> list[dict[str, Any]]:
    boxes, scores = rounded_boxes(detections)
    rows = zip(detections.classes, scores.tolist(), boxes.tolist(), detections.attributes, strict=True)
    return [
        {
            "class": name,
            "score": score,
            "center_m": box[:3],
            "size_wlh_m": box[3:6],
            "yaw_rad": box[6],
            "velocity_m_s": box[7:9],
            "attribute": attribute,
        }
        for name, score, box, attribute in rows
    ]
