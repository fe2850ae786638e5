"""Result files: JSON Lines, one frame a line; and the masks beside them."""

import json
import mmap
import os
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from ..runtime.detections import Detections
from ..runtime.errors import OutputError
from ..runtime.frame import Frame
from ..runtime.json_record import FiniteFloat, JsonRecord
from .images import write_png

FrameResult = dict[str, Any]  # a frame's line as JSON values, of the fields of `Line`
Triple = tuple[float, float, float]


class BoxResultSchema(JsonRecord):
    """A detection as a line holds it."""

    name: str = Field(alias="class")
    score: FiniteFloat
    center_m: Triple
    size_wlh_m: Triple
    yaw_rad: FiniteFloat
    velocity_m_s: tuple[float, float]


class FrameResultSchema(JsonRecord):
    """A frame's line; see `frame_result`."""

    scene: str
    token: str
    timestamp_s: FiniteFloat
    global_T_ego: tuple[tuple[float, float, float, float], ...]
    history: dict[str, int | str | None]
    skipped: str | None
    degraded: bool
    dropped: dict[str, int]
    boxes: tuple[BoxResultSchema, ...]
    maps: dict[str, str]


class ResultsFile:
    """`results.jsonl`: what is written is whole lines, one a frame, and stays when the run is broken off."""

    def __init__(self, path: Path) -> None:
        """Goes on behind what is in the file already. Raises OutputError when it cannot be opened."""
        self._path = path
        try:
            self._file = path.open("ab", buffering=0)
        except OSError as error:
            raise OutputError(f"cannot write {path}: {error.strerror}") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        with self._file:
            os.fsync(self._file.fileno())

    def write(self, record: FrameResult) -> None:
        """Append one frame, by one call to the system. Raises OutputError when it fails; no half of a line stays."""
        line = memoryview((json.dumps(record, allow_nan=False) + "\n").encode())
        end = self._file.seek(0, os.SEEK_END)
        try:
            while line:
                line = line[self._file.write(line) :]
        except OSError as error:
            with suppress(OSError):
                self._file.truncate(end)
            raise OutputError(f"cannot write {self._path}: {error.strerror}") from error


def drop_partial_line(path: Path) -> None:
    """Cut off the half line that a killed run may have left at the end of its results."""
    if not path.exists() or path.stat().st_size == 0:
        return
    with path.open("rb+") as file:
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            end = content.rfind(b"\n") + 1
        file.truncate(end)


def read_results(path: Path) -> Iterator[FrameResult]:
    """The frames of a results file, in its order. Raises OutputError, naming the line, for what is none."""
    if not path.exists():
        return
    with path.open("rb") as file:
        for number, line in enumerate(file, start=1):
            try:
                record = json.loads(line)
                FrameResultSchema.model_validate(record)
            except (ValueError, RecursionError):  # pydantic's is a ValueError
                raise OutputError(
                    f"{path}: line {number}: expected a frame's results; got {line[:40]!r}. Start anew."
                ) from None
            yield record


def write_masks(out: Path, index: int, maps: Mapping[str, NDArray[np.float32]]) -> dict[str, str]:
    """Write probabilities (X, Y) as 8-bit PNG files, row i at x_i, column j at y_j; returns their paths in `out`."""
    paths = {name: f"maps/{index:06d}_{name}.png" for name in maps}
    for name, mask in maps.items():
        write_png(out / paths[name], np.rint(255 * mask).astype(np.uint8))
    return paths


def frame_result(frame: Frame, detections: Detections, masks: Mapping[str, str]) -> FrameResult:
    """One frame as JSON values: nothing that another run would not give again.

    Boxes in the ego frame, best first, and the ego pose with them; maps by the path of their file.
    """
    return {
        "scene": detections.scene,
        "token": detections.token,
        "timestamp_s": detections.timestamp_s,
        "global_T_ego": np.asarray(frame.global_T_ego, dtype=np.float64).tolist(),
        "history": {"frames": detections.history.frames, "reset_reason": detections.history.reset_reason},
        "skipped": detections.skipped,
        "degraded": detections.degraded,
        "dropped": {"queries": detections.dropped_queries, "map_cells": detections.dropped_map_cells},
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
    }


def _rounded(values: NDArray[np.float32]) -> list[float]:
    return [round(float(value), 4) for value in values]
