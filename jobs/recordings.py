"""The recording of a run for a viewer: an .mcap file for Foxglove, or an .rrd file for rerun."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self

from ..data.images import read_png
from ..data.results import FrameResult, read_results, result_boxes
from ..data.source import Source
from ..drawing.recorded_frame import (
    APPLICATION,
    EARLIEST_S,
    LATEST_S,
    MapArea,
    RecordedFrame,
    predicted_boxes,
    true_boxes,
)
from ..runtime.errors import InputError, OutputError, UsageError
from ..runtime.extras import needs_extra
from ..runtime.files import move_into_place, output_errors, read_regular_file, remove_temporary, temporary_path
from ..runtime.frame import Frame
from ..runtime.printable import shortened
from .output_folder import check_writable
from .prefetch import prefetch
from .processed_frame import ProcessedFrame
from .run_folder import RESULTS_NAME


class Recording(Protocol):
    """A recording that is being written."""

    def add(self, recorded: RecordedFrame) -> None:
        """Append a frame. Raises OutputError."""

    def close(self) -> None:
        """Complete the file. Raises OutputError."""


class RecordingWriter:
    """Records the frames of a run. The file appears when the block ends.

    After an exception it holds the frames so far, and is valid. But an existing file is only replaced by a complete
    recording.
    """

    def __init__(self, path: Path, min_score: float, out: Path, source: Source, num_done: int, area: MapArea) -> None:
        """Most callers want `open_frame_writers`.

        path: of the .mcap or .rrd file.
        min_score: predictions with a lower score are left out.
        out: the folder of the run, with its results and maps.
        num_done: so many frames are in the results already. They are recorded first.
        area: of the maps.
        """
        self._path, self._min_score, self._out, self._area = path, min_score, out, area
        self._source, self._num_done = source, num_done
        self._temporary = temporary_path(path)
        self._num_frames = 0

    def __enter__(self) -> Self:
        recording_class = _IMPORTERS[self._path.suffix]()
        with output_errors(self._path):
            self._temporary.parent.mkdir(parents=True, exist_ok=True)
        with ExitStack() as stack:  # until the earlier frames are recorded, an exception leaves no file
            stack.callback(remove_temporary, self._temporary)
            self._recording = recording_class(self._temporary, self._path)
            stack.callback(self._recording.close)
            for frame, result in self._earlier_frames():
                self._record(frame, result)
            stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        try:
            self._recording.close()
            if kind is None or (self._num_frames and not self._path.exists()):
                with output_errors(self._path):
                    move_into_place(self._temporary, self._path)
        except OutputError:
            if kind is None:  # otherwise the first error is the cause
                raise
        finally:
            remove_temporary(self._temporary)

    def add(self, processed: ProcessedFrame) -> None:
        """Record a frame. Raises OutputError."""
        self._record(processed.frame, processed.result)

    def _record(self, frame: Frame, result: FrameResult) -> None:
        """Record the boxes of a result, which are rounded. So a resumed run records the same numbers."""
        boxes, scores, classes, _ = result_boxes(result, self._min_score)
        truth = frame.ground_truth if frame.ground_truth is not None and frame.ground_truth.has_boxes else None
        recorded = RecordedFrame(
            frame,
            predicted_boxes(boxes, classes, scores.tolist()),
            None if truth is None else true_boxes(truth),
            {name: read_png(self._out / path)[..., 0] for name, path in result["maps"].items()},
            self._area,
        )
        self._recording.add(recorded)
        self._num_frames += 1

    def _earlier_frames(self) -> Iterator[tuple[Frame, FrameResult]]:
        """The frames that an interrupted run has processed, with their results."""
        with prefetch(self._source.frame, range(self._num_done)) as frames:
            yield from zip(frames, read_results(self._out / RESULTS_NAME), strict=False)


def check_recording(path: Path, may_replace: bool) -> None:
    """Check that a recording can be written to `path`, before a long run.

    may_replace: whether an earlier recording of this toolkit may be replaced.
    Raises UsageError for another suffix, MissingExtraError, and OutputError. No file of another program is replaced.
    """
    if path.suffix not in _IMPORTERS:
        raise UsageError(
            f"--recording: expected a file name that ends with {' or '.join(_IMPORTERS)}; got {shortened(path.name)}."
        )
    try:
        str(path).encode()
    except UnicodeEncodeError:  # the libraries take names as UTF-8
        raise UsageError(f"--recording: expected a path in UTF-8; got {shortened(str(path))}.") from None
    _IMPORTERS[path.suffix]()
    check_writable(path.parent)
    if path.is_dir():
        raise OutputError(f"{path}: expected a file name for the recording; got a folder. Choose another name.")
    if path.exists():
        if not _is_ours(path):
            raise OutputError(f"{path}: this toolkit did not write this file. Choose another name for --recording.")
        if not may_replace:
            raise OutputError(
                f"{path}: an earlier run wrote this recording. Choose another name, or add --overwrite or --resume."
            )


def check_recordable(source: Source) -> None:
    """Check that the time stamps of a source can be the times of a recording. Raises InputError."""
    spans: dict[str, list[float]] = {}
    for index in range(len(source)):
        frame = source.frame_without_images(index)
        time_s = float(frame.timestamp_s)
        if not EARLIEST_S <= time_s <= LATEST_S:
            raise InputError(
                f"frame {index}: --recording: expected times from {EARLIEST_S:.0f} to {LATEST_S:.0f} s, the range of "
                f"the viewers; got {time_s!r} s. Give seconds since 1970, or from 0."
            )
        span = spans.setdefault(frame.scene, [time_s, time_s])
        span[:] = min(span[0], time_s), max(span[1], time_s)
    ordered = sorted(spans.items(), key=lambda item: item[1])
    for (one, (_, end_s)), (other, (start_s, _)) in pairwise(ordered):
        if start_s <= end_s:
            raise InputError(
                f"--recording: expected scenes at different times, because a recording has one time line; scenes "
                f"{shortened(one)} and {shortened(other)} overlap at {start_s!r} s. Run one scene per recording."
            )


def _is_ours(path: Path) -> bool:
    """Whether a file begins as the recordings of this toolkit."""
    try:
        return path.is_file() and APPLICATION.encode() in read_regular_file(path, 2**62, OutputError, start_only=True)
    except OutputError:
        return False


def _import_foxglove() -> Callable[[Path, Path], Recording]:
    with needs_extra("mcap"):
        from ..drawing.foxglove_recording import FoxgloveRecording
    return FoxgloveRecording


def _import_rerun() -> Callable[[Path, Path], Recording]:
    with needs_extra("rerun"):
        from ..drawing.rerun_recording import RerunRecording
    return RerunRecording


_IMPORTERS = {".mcap": _import_foxglove, ".rrd": _import_rerun}
