"""One frame to be judged: what was found in it, and what was there."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..runtime.detections import MAX_DETECTIONS, Detections
from ..runtime.errors import InputError
from ..runtime.frame import GroundTruth


@dataclass(frozen=True)
class Sample:
    """Detections and the truth of the same frame, both in its ego frame.

    true_attributes: nuScenes' names of the true boxes' attributes, "" where a box has none; None where the data name
    no attributes at all: they are then derived from the true speeds, by the rule that gives a detection its own.
    """

    detections: Detections
    ground_truth: GroundTruth
    true_attributes: Sequence[str] | None = None

    def check(self, number: int) -> None:
        """Refuse what the benchmark does not take. Raises InputError with the sample's number."""
        if len(self.detections) > MAX_DETECTIONS:
            raise InputError(
                f"sample {number}: expected at most {MAX_DETECTIONS} detections, as nuScenes takes; got "
                f"{len(self.detections)}. Leave out those of the lowest scores."
            )
        named = len(self.ground_truth.classes if self.true_attributes is None else self.true_attributes)
        if named != len(self.ground_truth.boxes):
            raise InputError(
                f"sample {number}: expected an attribute a true box, {len(self.ground_truth.boxes)}; got {named}. "
                'A box without one has the name "".'
            )
        _check_boxes(f"sample {number}: detections", self.detections.boxes, self.detections.classes)
        _check_boxes(f"sample {number}: true boxes", self.ground_truth.boxes, self.ground_truth.classes)
        scores = self.detections.scores
        if scores.shape != (len(self.detections.boxes),) or not np.isfinite(scores).all():
            raise InputError(f"sample {number}: detections: expected a finite score a box. Leave others out.")


def _check_boxes(what: str, boxes: NDArray[np.floating], classes: Sequence[str]) -> None:
    """Finite numbers but for the velocities, which may be unknown (NaN), and sizes above 0."""
    if boxes.shape != (len(classes), 9):
        raise InputError(f"{what}: expected (D, 9) numbers and D class names; got {boxes.shape} and {len(classes)}.")
    if not np.isfinite(boxes[:, :7]).all():
        raise InputError(f"{what}: expected finite places, sizes and yaws; got others. Leave such boxes out.")
    if not (boxes[:, 3:6] > 0).all():
        raise InputError(f"{what}: expected sizes above 0 m; got {boxes[:, 3:6].min():g}. Leave such boxes out.")
