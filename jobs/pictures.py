"""The pictures of a run: `pictures/000000.png`, one a frame, and `video.mp4`."""

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from ..data.images import read_png, write_png
from ..drawing import VideoWriter, draw_frame
from ..runtime import Detections, Frame
from .output_folder import VIDEO_NAME
from .run_progress import RunProgress


@dataclass(frozen=True)
class Pictures:
    """Which pictures are wanted.

    ground_truth: draw the source's own boxes; min_score: draw the detections that have it, or none where it is None.
    """

    draw: bool = False
    video: bool = False
    ground_truth: bool = False
    min_score: float | None = 0.3

    @property
    def wanted(self) -> bool:
        return self.draw or self.video


class PictureWriter:
    """Draws frame after frame; the video appears when the album is closed without an error."""

    def __init__(self, out: Path, pictures: Pictures, range_m: float, tally: RunProgress) -> None:
        """tally: the frames that are drawn already, by a run that broke off."""
        self._out, self._pictures, self._range_m = out, pictures, range_m
        self._start_s: float | None = tally.start_s if tally.frames else None
        self._stack = ExitStack()
        self._video = self._stack.enter_context(VideoWriter(out / VIDEO_NAME)) if pictures.video else None
        if self._video:
            for index in range(tally.frames):
                self._video.write(read_png(self._path(index)))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._stack.__exit__(kind, error, traceback)

    def add(self, index: int, frame: Frame, detections: Detections) -> None:
        """Draw frame `index` of the source and write it."""
        self._start_s = frame.timestamp_s if self._start_s is None else self._start_s
        wanted = self._pictures
        threshold = np.inf if wanted.min_score is None else wanted.min_score
        kept = np.flatnonzero(detections.scores >= threshold)
        picture = draw_frame(
            frame,
            detections.boxes[kept],
            [detections.classes[index] for index in kept],
            detections.scores[kept],
            ground_truth=frame.ground_truth if wanted.ground_truth else None,
            maps=detections.maps,
            range_m=self._range_m,
            start_s=self._start_s,
        )
        if wanted.draw:
            write_png(self._path(index), picture)
        if self._video:
            self._video.write(picture)

    def _path(self, index: int) -> Path:
        return self._out / "pictures" / f"{index:06d}.png"
