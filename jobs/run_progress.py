"""The progress of a run: counts over the frames so far, whether this run or an interrupted one wrote them."""

from dataclasses import dataclass, field

from ..data.results import FrameResult
from ..runtime.window_selection import WindowSelection


@dataclass
class RunProgress:
    """Counts over the frames of a run.

    selection: of the frames of the temporal window.
    scene, start_s: name of the current scene, and time stamp of its first frame.
    history: index and time stamp of the processed frames that later frames may need, the newest first. They are of the
        scene of the newest processed frame.
    """

    selection: WindowSelection
    frames: int = 0
    boxes: int = 0
    degraded: int = 0
    skipped: int = 0
    scene: str | None = None
    start_s: float = 0.0
    history: list[tuple[int, float]] = field(default_factory=list)
    _history_scene: str | None = None

    def add(self, result: FrameResult) -> None:
        """Count one frame."""
        if result["scene"] != self.scene:
            self.scene, self.start_s = result["scene"], result["timestamp_s"]
        if result["skipped"] is None:
            self._remember(result)
        self.frames += 1
        self.boxes += len(result["boxes"])
        self.degraded += bool(result["degraded"])
        self.skipped += result["skipped"] is not None

    def _remember(self, result: FrameResult) -> None:
        earlier = self.history if result["scene"] == self._history_scene else []
        self._history_scene, now_s = result["scene"], result["timestamp_s"]
        history = [(self.frames, now_s), *earlier]
        self.history = history[: self.selection.num_needed([now_s - time_s for _, time_s in history])]
