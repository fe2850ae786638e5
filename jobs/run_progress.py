"""The progress of a run: counts over the frames so far, whether this run or an interrupted one wrote them."""

from collections import deque
from dataclasses import dataclass, field

from ..data.results import FrameResult


@dataclass
class RunProgress:
    """Counts over the frames of a run.

    num_window_frames: frames in the temporal window, the current one included.
    start_s: timestamp of the first frame.
    history: index and timestamp of the newest frames that were not skipped, as many as the next frame's window needs.
    """

    num_window_frames: int
    frames: int = 0
    boxes: int = 0
    degraded: int = 0
    skipped: int = 0
    start_s: float = 0.0
    history: deque[tuple[int, float]] = field(init=False)

    def __post_init__(self) -> None:
        self.history = deque(maxlen=max(1, self.num_window_frames - 1))

    def add(self, result: FrameResult) -> None:
        """Count one frame."""
        if self.frames == 0:
            self.start_s = result["timestamp_s"]
        if result["skipped"] is None:
            self.history.append((self.frames, result["timestamp_s"]))
        self.frames += 1
        self.boxes += len(result["boxes"])
        self.degraded += bool(result["degraded"])
        self.skipped += result["skipped"] is not None
