"""Parity results without a comparison, for tests of the code around the parity check."""

from typing import Any

from duospacenet.export import ParityResult
from duospacenet.export.parity.sequence_coverage import Coverage
from duospacenet.export.parity.weight_match import WeightMatch

NO_COVERAGE = Coverage(
    frames=0, skipped=0, windows={}, lost_cameras=[], motion={}, calibrations=0, resets={}, dropped_frames=0
)
NO_WEIGHTS = WeightMatch(
    parameters=0,
    matched=0,
    values=0,
    matched_values=0,
    not_found=(),
    differing=(),
    unexplained=(),
    attributes=(),
)


def passing_result(**changes: Any) -> ParityResult:
    """A result that passes, of a check that compared nothing. changes: other values of its fields."""
    fields: dict[str, Any] = {
        "source": "none",
        "frames": 0,
        "graphs": {},
        "stream": [],
        "coverage": NO_COVERAGE,
        "shortfalls": [],
        "random_inputs": {},
        "scales": {},
        "liveness": {},
        "manifest": [],
        "weights": NO_WEIGHTS,
    }
    return ParityResult(**fields | changes)
