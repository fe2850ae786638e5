"""The measured durations of one target, and their percentiles."""

from array import array
from collections.abc import Mapping, Sequence

import numpy as np

from .bench_report import Percentiles

FRAME = "frame"  # the duration of the whole frame, beside those of its stages

# A percentile needs at least one sample beyond it: p99 of 50 samples would only be their maximum.
MIN_SAMPLES = {0.5: 1, 0.9: 10, 0.99: 100, 0.999: 1000}


class Samples:
    """Durations [s] by stage, and the median frame of each round. 8 bytes are kept per frame and stage."""

    def __init__(self) -> None:
        self._seconds: dict[str, array] = {}
        self.round_medians_s: list[float] = []

    def add_round(self, rows: Sequence[Mapping[str, float]]) -> None:
        """Add the frames of one round: durations [s] by stage, and of the whole frame under `FRAME`."""
        for row in rows:
            for stage, seconds in row.items():
                self._seconds.setdefault(stage, array("d")).append(seconds)
        self.round_medians_s.append(float(np.median([row[FRAME] for row in rows])))

    def __len__(self) -> int:
        return len(self._seconds[FRAME]) if self._seconds else 0

    @property
    def stages(self) -> list[str]:
        """The stages in the order in which they run."""
        return [stage for stage in self._seconds if stage != FRAME]

    def percentiles_ms(self, stage: str = FRAME) -> Percentiles:
        """The percentiles of a stage [ms]."""
        return percentiles([1000 * seconds for seconds in self._seconds[stage]])


def percentiles(samples: Sequence[float]) -> Percentiles:
    """The percentiles of at least one sample. Each is a sample itself: the smallest that is not below its share."""
    values = {
        share: round(float(np.quantile(samples, share, method="inverted_cdf")), 4)
        for share, needed in MIN_SAMPLES.items()
        if len(samples) >= needed
    }
    return Percentiles(p50=values[0.5], p90=values.get(0.9), p99=values.get(0.99), p99_9=values.get(0.999))
