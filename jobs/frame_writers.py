"""The writers of a run's pictures, heatmaps and recording, one frame after the other."""

import math
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Protocol

from ..data.source import Source
from ..drawing.recorded_frame import MapArea
from ..runtime.bundle.manifest import Manifest
from .heatmaps import HeatmapRecorder, HeatmapWriter
from .pictures import PictureOptions, PictureWriter
from .processed_frame import ProcessedFrame
from .recordings import RecordingWriter
from .run_progress import RunProgress


class FrameWriter(Protocol):
    """Writes files about processed frames."""

    def add(self, processed: ProcessedFrame) -> None:
        """Write what belongs to one frame. Raises OutputError."""


@contextmanager
def open_frame_writers(
    out: Path,
    options: PictureOptions,
    heatmaps: HeatmapRecorder | None,
    source: Source,
    manifest: Manifest,
    done: RunProgress,
) -> Iterator[Sequence[FrameWriter]]:
    """Give the writers that the options ask for. Their files are completed when the block ends.

    out: folder of the run.
    heatmaps: of the pipeline on which the stream was opened; None for no heatmaps.
    done: the frames that an interrupted run has written.
    """
    lower_m, upper_m = manifest.perception.lower_m[:2], manifest.perception.upper_m[:2]
    range_m, min_score = max(map(abs, upper_m)), math.inf if options.min_score is None else options.min_score
    with ExitStack() as stack:
        writers: list[FrameWriter] = []
        if options.wanted:
            writers.append(stack.enter_context(PictureWriter(out, options, range_m, done)))
        if heatmaps is not None:
            writers.append(HeatmapWriter(out, heatmaps, min_score, range_m))
        if options.recording is not None:
            recording = RecordingWriter(
                options.recording, min_score, out, source, done.frames, MapArea(lower_m, upper_m)
            )
            writers.append(stack.enter_context(recording))
        yield writers
