"""Which past frames are in the temporal window of the current frame, by their ages only."""

from collections.abc import Sequence
from dataclasses import dataclass

from .errors import UsageError

TIE_S = 1e-3  # ages that differ by less are equal: time stamps near 1.5e9 s are rounded, and clocks jitter


@dataclass(frozen=True)
class WindowSelection:
    """Selects the past frames of a temporal window.

    num_past: frames of the window besides the current one.
    step_s: None for the newest frames, whatever their ages. Otherwise the time between two frames of the window [s],
        for streams that are faster than the data that the model was trained on. For k = 1, 2, ..., num_past in turn,
        slot k gets the frame whose age is nearest to k · step_s, among the frames that are

        - at least step_s / 2 older than the frame of slot k - 1 (slot 0 is the current frame), and
        - at most largest_gap_s older than that frame.

        Of two frames that are equally near, up to 1 ms, the newer one is selected. If there is no such frame, slot k
        and the slots after it stay empty.
    largest_gap_s: the manifest's largest time between two frames.

    A stream whose frames come step_s apart, with small jitter or dropped frames, gets its newest frames, as with None.
    """

    num_past: int
    step_s: float | None = None
    largest_gap_s: float = float("inf")

    def __post_init__(self) -> None:
        """Raise UsageError for a step that is not above 0 and at most `largest_gap_s`."""
        if self.step_s is not None and not 10 * TIE_S <= self.step_s <= self.largest_gap_s:
            raise UsageError(
                f"history step: expected {10 * TIE_S:g} to {self.largest_gap_s:g} s, the manifest's largest time "
                f"between two frames; got {self.step_s:g}."
            )

    def select(self, ages_s: Sequence[float]) -> list[int]:
        """Select the frames of slots 1, 2, ...; returns indices into `ages_s`.

        ages_s: of the past frames, newest first.
        """
        if self.step_s is None:
            return list(range(len(ages_s)))[: self.num_past]
        selected: list[int] = []
        last_s = 0.0
        for slot in range(1, self.num_past + 1):
            nearest = self._nearest(ages_s, slot * self.step_s, last_s)
            if nearest is None:
                break
            selected.append(nearest)
            last_s = ages_s[nearest]
        return selected

    def num_needed(self, ages_s: Sequence[float]) -> int:
        """Return how many of the newest frames later windows may need. The others can be forgotten.

        ages_s: of the frames relative to the newest one, which is the first and has age 0.

        At least one frame is needed, because the next frame must be later than the newest one.
        """
        if self.step_s is None:
            return min(len(ages_s), max(1, self.num_past))
        # Slot k never needs a frame that is older than the newest one with an age of at least k steps that also is half
        # a step older than the frame of slot k - 1 found in this way. Ages only grow, so this stays true.
        oldest_s, needed = 0.0, 1
        for slot in range(1, self.num_past + 1):
            beyond = max(slot * self.step_s, oldest_s + self.step_s / 2)
            found = next((index for index, age_s in enumerate(ages_s) if age_s >= beyond), None)
            if found is None:
                return len(ages_s)
            oldest_s, needed = ages_s[found], found + 1
        return needed

    def _nearest(self, ages_s: Sequence[float], age_s: float, last_s: float) -> int | None:
        """The index of the frame of a slot with the nominal age `age_s`, after a slot with a frame of age `last_s`."""
        assert self.step_s is not None
        best = None
        for index, each_s in enumerate(ages_s):
            if last_s + self.step_s / 2 - TIE_S <= each_s <= last_s + self.largest_gap_s:
                distance_s = abs(each_s - age_s)
                if best is None or distance_s < abs(ages_s[best] - age_s) - TIE_S:
                    best = index
        return best
