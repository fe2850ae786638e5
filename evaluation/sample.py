"""One sample of an evaluation: the detections and the ground truth of one frame."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..runtime.detections import MAX_DETECTIONS, Detections
from ..runtime.errors import InputError
from ..runtime.frame import GroundTruth


@dataclass(frozen=True)
class Sample:
    """Detections and ground truth of one frame, both in its ego frame.

    true_attributes: the nuScenes attribute name of each ground-truth box, "" for a box without attribute. None if the
        data have no attributes; they are then derived from class and speed, as for detections.
    """

    detections: Detections
    ground_truth: GroundTruth
    true_attributes: Sequence[str] | None = None

    def check(self, number: int) -> None:
        """Raise InputError, with the sample's number, if the benchmark does not accept this sample."""
        if len(self.detections) > MAX_DETECTIONS:
            raise InputError(
                f"sample {number}: expected at most {MAX_DETECTIONS} detections, the limit of nuScenes; got "
                f"{len(self.detections)}. Remove those with the lowest scores."
            )
        num_true = len(self.ground_truth.boxes)
        num_names = len(self.ground_truth.classes if self.true_attributes is None else self.true_attributes)
        if num_names != num_true:
            raise InputError(
                f"sample {number}: expected one attribute per ground-truth box, {num_true}; got {num_names}. "
                'Use "" for a box without an attribute.'
            )
        _check_boxes(f"sample {number}: detections", self.detections.boxes, self.detections.classes)
        _check_boxes(f"sample {number}: ground truth", self.ground_truth.boxes, self.ground_truth.classes)
        num_points = self.ground_truth.num_points
        if num_points is not None and num_points.shape != (num_true,):
            raise InputError(
                f"sample {number}: ground truth: expected num_points of shape ({num_true},), one number per box; got "
                f"{num_points.shape}. Use -1 for a box with an unknown number."
            )
        scores = self.detections.scores
        if scores.shape != (len(self.detections.boxes),) or not np.isfinite(scores).all():
            raise InputError(
                f"sample {number}: detections: expected one finite score per box; got scores of shape {scores.shape}, "
                f"{np.isfinite(scores).sum()} of them finite. Remove boxes without a score."
            )


def _check_boxes(name: str, boxes: NDArray[np.floating], classes: Sequence[str]) -> None:
    """Check shape, finite numbers and positive sizes. Velocities may be unknown (NaN)."""
    if boxes.shape != (len(classes), 9):
        raise InputError(
            f"{name}: expected boxes of shape (D, 9) and D class names; got {boxes.shape} and {len(classes)}."
        )
    if not np.isfinite(boxes[:, :7]).all():
        raise InputError(f"{name}: expected finite positions, sizes and yaws; got NaN or infinity. Remove such boxes.")
    if not (boxes[:, 3:6] > 0).all():
        raise InputError(f"{name}: expected sizes above 0 m; got {boxes[:, 3:6].min():g}. Remove such boxes.")
