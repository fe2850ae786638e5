"""Follows a batch: which frames and scenes are done, for one display of progress over all workers."""

from collections.abc import Iterable, Iterator, Mapping, Sequence

from ...runtime.progress import Progress
from ..notify import Notify
from .batch_events import BatchEvent, SceneEnded, SceneFrames, WorkerLost
from .batch_records import SceneOutcome
from .scene_list import Scene


class BatchProgress:
    """Collects the outcomes of the scenes, and tells the user of failures.

    outcomes: by scene id. lost_workers: number of lost worker processes.
    """

    def __init__(self, scenes: Sequence[Scene], finished: Mapping[str, SceneOutcome], notify: Notify) -> None:
        """finished: outcomes of scenes that an earlier call has finished."""
        self.outcomes = dict(finished)
        self.lost_workers = 0
        self._frames = {scene.scene_id: scene.piece.frames for scene in scenes}
        self._shown: dict[str, int] = {scene_id: self._frames[scene_id] for scene_id in finished}
        self._causes: dict[str, str] = {}
        self._failed = 0
        self._notify = notify

    def show(self, events: Iterable[BatchEvent], progress: Progress) -> None:
        """Consume all events, and show a progress in frames."""
        total, done = sum(self._frames.values()), sum(self._shown.values())
        for _ in progress(self._new_frames(events), "batch", total, done=done, label=self._label):
            pass

    def _new_frames(self, events: Iterable[BatchEvent]) -> Iterator[str]:
        """Yield the scene of each frame once, also if a frame is processed again after a worker was lost."""
        for event in events:
            match event:
                case SceneFrames(scene_id, frames):
                    yield from self._advance(scene_id, frames)
                case SceneEnded(scene_id, outcome):
                    self._end(scene_id, outcome)
                    yield from self._advance(scene_id, outcome.frames)
                case WorkerLost(worker, scene_id, cause):
                    self.lost_workers += 1
                    self._causes[scene_id] = cause
                    text = f"warning: {worker} was lost ({cause}). Another process continues scene {scene_id}."
                    self._notify(text)

    def _advance(self, scene_id: str, frames: int) -> Iterator[str]:
        new_frames = range(self._shown.get(scene_id, 0), frames)
        self._shown[scene_id] = max(frames, self._shown.get(scene_id, 0))
        for _ in new_frames:
            yield scene_id

    def _end(self, scene_id: str, outcome: SceneOutcome) -> None:
        if not outcome.is_done:
            self._failed += 1
            if outcome.tries > 1 and scene_id in self._causes:
                cause = f"{outcome.cause} (the last process: {self._causes[scene_id]})"
                outcome = outcome.model_copy(update={"cause": cause})
            self._notify(f"scene {scene_id} failed: {outcome.cause}")
        self.outcomes[scene_id] = outcome

    def _label(self, scene_id: str) -> str:
        failures = f", {self._failed} failed" if self._failed else ""
        return f"{len(self.outcomes) - self._failed} of {len(self._frames)} scenes done{failures}, {scene_id}"
