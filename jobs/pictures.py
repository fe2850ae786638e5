"""The pictures of a run: `pictures/000000.png`, one per frame, and `video.mp4`."""

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from ..data.images import read_png, write_png
from ..drawing import VideoWriter, draw_frame
from ..runtime import Detections, Frame
from .processed_frame import ProcessedFrame
from .run_folder import VIDEO_NAME
from .run_progress import RunProgress


@dataclass(frozen=True)
class PictureOptions:
    """Which pictures a run writes.

    draw: write one picture per frame.
    video: write the pictures as a video.
    ground_truth: draw the source's own boxes too.
    min_score: detections with a lower score are not drawn, 0 to 1; None draws no detections.
    heatmaps: write the network's features as one picture per frame.
    recording: path of a recording for a viewer; None for none.
    """

    draw: bool = False
    video: bool = False
    ground_truth: bool = False
    min_score: float | None = 0.3
    heatmaps: bool = False
    recording: Path | None = None

    @property
    def wanted(self) -> bool:
        """Whether the run renders any pictures of boxes."""
        return self.draw or self.video


class PictureWriter:
    """Renders one picture per frame. The video appears when the writer is closed without an error."""

    def __init__(self, out: Path, options: PictureOptions, range_m: float, progress: RunProgress) -> None:
        """Start writing, or continue after the frames that `progress` counts, which an interrupted run rendered.

        range_m: extent of the bird's-eye view from the ego, in metres.
        """
        self._out, self._options, self._range_m = out, options, range_m
        self._scene, self._start_s = progress.scene, progress.start_s
        self._stack = ExitStack()
        self._video = self._stack.enter_context(VideoWriter(out / VIDEO_NAME)) if options.video else None
        if self._video:
            for index in range(progress.frames):
                self._video.write(read_png(self._path(index)))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._stack.__exit__(kind, error, traceback)

    def add(self, processed: ProcessedFrame) -> None:
        """Render a frame and write it."""
        frame = processed.frame
        if frame.scene != self._scene:
            self._scene, self._start_s = frame.scene, frame.timestamp_s
        picture = self._render(frame, processed.detections, self._start_s)
        if self._options.draw:
            write_png(self._path(processed.index), picture)
        if self._video:
            self._video.write(picture)

    def _render(self, frame: Frame, detections: Detections, start_s: float) -> np.ndarray:
        threshold = np.inf if self._options.min_score is None else self._options.min_score
        kept = np.flatnonzero(detections.scores >= threshold)
        return draw_frame(
            frame,
            detections.boxes[kept],
            [detections.classes[index] for index in kept],
            detections.scores[kept],
            ground_truth=frame.ground_truth if self._options.ground_truth else None,
            maps=detections.maps,
            range_m=self._range_m,
            start_s=start_s,
        )

    def _path(self, index: int) -> Path:
        return self._out / "pictures" / f"{index:06d}.png"
