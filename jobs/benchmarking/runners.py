"""Runs single frames and measures them: of a bundle, as its users run it, or of any other target."""

import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Protocol

from ...runtime import Frame, Pipeline, Stream
from ...runtime.errors import InputError
from .samples import FRAME


class Runner(Protocol):
    """A loaded target."""

    window: int  # number of frames in a full window

    def step(self, frame: Frame) -> Mapping[str, float]:
        """Run the next frame of a stream; returns the duration of each stage [s]."""

    def reset(self) -> None:
        """Reset the history: the next frame is the first of a stream."""


class BundleRunner:
    """A bundle in the runtime's pipeline, with maps if it has map classes."""

    def __init__(self, pipeline: Pipeline) -> None:
        self.pipeline = pipeline
        self.window = pipeline.manifest.window.num_frames
        self._stream = self.open_stream()

    @classmethod
    def load(cls, bundle: Path, threads: int, engine: str, engine_precision: str) -> "BundleRunner":
        """Load a bundle. Raises ArtifactError and MissingExtraError."""
        return cls(Pipeline.load(bundle, threads, engine=engine, engine_precision=engine_precision))

    def open_stream(self) -> Stream:
        """A new stream of the pipeline."""
        return self.pipeline.stream(maps="segmenter" in self.pipeline.sessions)

    def step(self, frame: Frame) -> Mapping[str, float]:
        detections = self._stream.step(frame)
        if detections.skipped or detections.history.reset_reason:
            reason = detections.skipped or detections.history.reset_reason
            raise InputError(f"expected frames that continue each other; got {reason}. Choose another --source.")
        return detections.timings_s

    def reset(self) -> None:
        self._stream.reset()


def measure_frames(runner: Runner, frames: Iterator[Frame], count: int) -> list[dict[str, float]]:
    """Run frames and measure them: the duration [s] of each stage, and of the whole frame under `FRAME`."""
    rows = []
    for _ in range(count):
        frame = next(frames)
        start_s = time.perf_counter()
        stages = runner.step(frame)
        rows.append({**stages, FRAME: time.perf_counter() - start_s})
    return rows


def measure_first_frame(runner: Runner, frames: Iterator[Frame]) -> float:
    """The duration [s] of the first frame of a stream, whose window is one frame. The window is then filled again."""
    runner.reset()
    first, *_ = measure_frames(runner, frames, runner.window)
    return first[FRAME]


class Throughput:
    """Streams of one pipeline, each in a separate thread."""

    def __init__(self, runner: BundleRunner, new_frames: Callable[[], Iterator[Frame]], min_frames: int = 2) -> None:
        """new_frames: gives the frames of another stream. min_frames: of each stream in a measurement."""
        self._runner, self._new_frames, self._min_frames = runner, new_frames, min_frames
        self._streams: list[tuple[Stream, Iterator[Frame]]] = []

    def measure(self, num_streams: int, duration_s: float) -> tuple[int, float]:
        """Run streams until the duration is over; returns the number of frames of all streams, and the time [s].

        Their windows are full before the measurement starts.
        """
        while len(self._streams) < num_streams:
            self._streams.append(self._open_stream())
        start_s = time.perf_counter()

        def run(index: int) -> int:
            (stream, frames), count = self._streams[index], 0
            while count < self._min_frames or time.perf_counter() - start_s < duration_s:
                stream.step(next(frames))
                count += 1
            return count

        with ThreadPoolExecutor(num_streams) as threads:
            counts = list(threads.map(run, range(num_streams)))
        return sum(counts), time.perf_counter() - start_s

    def _open_stream(self) -> tuple[Stream, Iterator[Frame]]:
        stream, frames = self._runner.open_stream(), self._new_frames()
        for _ in range(self._runner.window):
            stream.step(next(frames))
        return stream, frames
