"""The summary of a batch: counts, throughput, and every scene with its outcome."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .batch_folder import SUMMARY_NAME
from .batch_records import SceneOutcome

SUMMARY_VERSION = 1
MAX_NAMES = 3  # in a message


@dataclass(frozen=True)
class WorkerThroughput:
    """The work of one worker in this call.

    frames: that it processed. seconds: during which it processed scenes, with the checks before the first frame.
    """

    worker: str
    scenes: int
    frames: int
    seconds: float

    @property
    def frames_per_s(self) -> float:
        return self.frames / self.seconds if self.seconds else 0.0


@dataclass(frozen=True)
class BatchSummary:
    """The result of a batch.

    outcomes: of all scenes, in the order of the sources.
    new: ids of the scenes that this call has processed; an earlier call has finished the others.
    lost_workers: worker processes that ended while they processed a scene. Ray does not tell their number.
    seconds: duration of this call, with the start of the workers.
    has_submission: whether the submission of all scenes was written.
    """

    out: Path
    outcomes: Sequence[SceneOutcome]
    new: Collection[str]
    lost_workers: int
    seconds: float
    has_submission: bool

    @property
    def path(self) -> Path:
        """Of `summary.json`."""
        return self.out / SUMMARY_NAME

    @property
    def failed(self) -> list[SceneOutcome]:
        """The scenes that have failed."""
        return [outcome for outcome in self.outcomes if not outcome.is_done]

    def describe_failures(self) -> str:
        """Return which scenes have failed, and what to do. At least one has."""
        names = [outcome.scene for outcome in self.failed]
        more = f" and {len(names) - MAX_NAMES} more" if len(names) > MAX_NAMES else ""
        return (
            f"{len(names)} of {len(self.outcomes)} scenes failed: {', '.join(names[:MAX_NAMES])}{more}. The causes are "
            f"in {self.path}. --resume tries them again."
        )

    @property
    def workers(self) -> list[WorkerThroughput]:
        """The throughput of each worker in this call."""
        new = [outcome for outcome in self.outcomes if outcome.scene in self.new]
        rows = []
        for worker in sorted({outcome.worker for outcome in new}):
            own = [outcome for outcome in new if outcome.worker == worker]
            frames, seconds = sum(each.new_frames for each in own), sum(each.seconds for each in own)
            rows.append(WorkerThroughput(worker, len(own), frames, seconds))
        return rows

    @property
    def new_frames(self) -> int:
        """Frames that this call has processed, in the last try of each scene."""
        return sum(worker.frames for worker in self.workers)

    def count(self, field: str) -> int:
        """The sum of a field of `SceneOutcome` over all scenes."""
        return sum(getattr(outcome, field) for outcome in self.outcomes)

    def to_dict(self) -> dict[str, Any]:
        """The content of `summary.json`."""
        return {
            "schema_version": SUMMARY_VERSION,
            "scenes": len(self.outcomes),
            "done": len(self.outcomes) - len(self.failed),
            "failed": len(self.failed),
            "new_scenes": len(self.new),
            **{field: self.count(field) for field in ("frames", "boxes", "degraded", "skipped")},
            "new_frames": self.new_frames,
            "seconds": round(self.seconds, 3),
            "frames_per_s": round(self.new_frames / self.seconds, 3) if self.seconds else 0.0,
            "lost_workers": self.lost_workers,
            "submission": self.has_submission,
            "workers": [{**vars(row), "frames_per_s": round(row.frames_per_s, 3)} for row in self.workers],
            "outcomes": [outcome.model_dump(mode="json") for outcome in self.outcomes],
        }
