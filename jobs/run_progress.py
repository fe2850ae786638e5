"""How far a run is: what its results so far, of this run or of one that broke off, add up to."""

from collections import deque
from dataclasses import dataclass, field

from ..data.results import FrameResult


@dataclass
class RunProgress:
    """Counts over the frames of a run.

    start_s: the time of the first frame.
    looked_at: the newest frames that were not skipped, as (index, time stamp), as many as a window looks back to.
    """

    window: int
    frames: int = 0
    boxes: int = 0
    degraded: int = 0
    skipped: int = 0
    start_s: float = 0.0
    looked_at: deque[tuple[int, float]] = field(init=False)

    def __post_init__(self) -> None:
        self.looked_at = deque(maxlen=max(1, self.window - 1))

    def add(self, record: FrameResult) -> None:
        """Count one frame."""
        if self.frames == 0:
            self.start_s = record["timestamp_s"]
        if record["skipped"] is None:
            self.looked_at.append((self.frames, record["timestamp_s"]))
        self.frames += 1
        self.boxes += len(record["boxes"])
        self.degraded += bool(record["degraded"])
        self.skipped += record["skipped"] is not None
