"""A history that the pipeline drops at nearly every frame, so that the detector works on single frames."""

from collections import Counter

from ..runtime.errors import InputError
from ..runtime.frame import Frame
from ..runtime.history import ResetKind, ResetLimits, find_reset
from .findings import Finding, Verdict

LEAST_RESETS = 2
LEAST_RESETS_BY_SCENE = 3  # a few frames of different scenes may be wanted
LEAST_SHARE = 0.8  # of all frames after the first

CAUSES: dict[ResetKind, str] = {
    "new scene": "Likely cause: `scene` holds a name of the frame instead of the drive.",
    "gap": "Likely cause: most frames are missing, or the times are not in seconds.",
    "ego jump": "Likely cause: the positions are not in metres, or the times are not in seconds.",
    "ego turn": "Likely cause: the headings in the poses are wrong, or the times are not in seconds.",
}
REMEDIES: dict[ResetKind, str] = {
    "new scene": "Give all frames of a drive the same scene.",
    "gap": "Give `timestamp_s` in seconds, and more frames per second.",
    "ego jump": "Correct `global_T_ego` or `timestamp_s`.",
    "ego turn": "Correct `global_T_ego` or `timestamp_s`.",
}


class HistoryResets:
    """Counts the frames at which the pipeline drops its history. Keeps the last frame."""

    def __init__(self, limits: ResetLimits) -> None:
        self._limits = limits
        self._before: Frame | None = None
        self._num_steps = 0
        self._kinds: Counter[ResetKind] = Counter()
        self._first: tuple[int, str] = 0, ""  # index and reason of the first reset

    def add(self, index: int, frame: Frame) -> None:
        """Add the next frame. A frame that is not later than the one before is not counted."""
        before, self._before = self._before, frame
        if before is None:
            return
        try:
            reason = find_reset(before, frame, self._limits)
        except InputError:
            return
        self._num_steps += 1
        if reason is not None:
            self._first = self._first if self._kinds else (index, reason.text)
            self._kinds[reason.kind] += 1

    def drive_findings(self) -> list[Finding]:
        """A finding if the history is dropped at nearly every frame."""
        num_resets = self._kinds.total()
        if num_resets < LEAST_RESETS or num_resets < LEAST_SHARE * self._num_steps:
            return []
        kind, _ = self._kinds.most_common(1)[0]
        if kind == "new scene" and num_resets < LEAST_RESETS_BY_SCENE:
            return []
        index, reason = self._first
        return [
            Finding(
                "history",
                Verdict.SUSPECT,
                "frames that continue each other",
                f"a history that is dropped at {num_resets} of {self._num_steps} frames after the first: {reason}",
                CAUSES[kind],
                REMEDIES[kind],
                index,
                num_resets,
            )
        ]
