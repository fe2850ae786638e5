"""One sample of an evaluation: the detections and the ground truth of one frame."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from ..data.global_boxes import to_global
from ..data.submitted_boxes import SubmittedBoxes
from ..runtime.attributes import ATTRIBUTES, NO_ATTRIBUTE
from ..runtime.detections import MAX_DETECTIONS, Detections
from ..runtime.errors import InputError
from ..runtime.frame import GroundTruth

_NAMES_OF_ATTRIBUTES = frozenset((*ATTRIBUTES, NO_ATTRIBUTE))


class DetectedObjects(Protocol):
    """The fields of `runtime.Detections` that an evaluation uses; their numbers may be float64 as well."""

    @property
    def boxes(self) -> NDArray[np.floating]: ...

    @property
    def scores(self) -> NDArray[np.floating]: ...

    @property
    def classes(self) -> tuple[str, ...]: ...

    @property
    def attributes(self) -> tuple[str, ...]: ...

    @property
    def maps(self) -> Mapping[str, NDArray[np.float32]]: ...

    @property
    def skipped(self) -> str | None: ...


@dataclass(frozen=True)
class Sample:
    """Detections and ground truth of one frame, both in the same frame, z up.

    nuScenes' benchmark uses the global frame, see `in_global_frame`. True attributes that are unknown are derived from
    class and speed, as for detections.

    ego_m: (3,) position of the ego. The ranges of classes are distances from it in x and y.
    """

    detections: DetectedObjects
    ground_truth: GroundTruth
    ego_m: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))

    @classmethod
    def of_detections(
        cls, detections: Detections, ground_truth: GroundTruth, global_T_ego: NDArray[np.float64]
    ) -> Self:
        """The sample of a frame, in the global frame. Detections and ground truth are in the ego frame.

        The detections are rounded as in a submission, so that the scores are those of the run's submission.
        global_T_ego: (4, 4) ego pose of the frame.
        """
        pose = np.asarray(global_T_ego, np.float64)
        return cls.in_global_frame(SubmittedBoxes.of_detections(detections, pose), ground_truth, pose)

    @classmethod
    def in_global_frame(
        cls, submitted: SubmittedBoxes, ground_truth: GroundTruth, global_T_ego: NDArray[np.float64]
    ) -> Self:
        """The sample as nuScenes' benchmark evaluates it.

        submitted: detections in the global frame.
        ground_truth: in the ego frame.
        global_T_ego: (4, 4) ego pose of the frame.
        """
        true_boxes = to_global(ground_truth.boxes, global_T_ego)
        return cls(submitted, replace(ground_truth, boxes=true_boxes), global_T_ego[:3, 3])

    def check(self, number: int) -> None:
        """Raise InputError, with the sample's number, if the benchmark does not accept this sample."""
        if len(self.detections.boxes) > MAX_DETECTIONS:
            raise InputError(
                f"sample {number}: expected at most {MAX_DETECTIONS} detections, the limit of nuScenes; got "
                f"{len(self.detections.boxes)}. Remove those with the lowest scores."
            )
        self._check_detections(f"sample {number}: detections")
        self._check_ground_truth(f"sample {number}: ground truth")

    def _check_detections(self, name: str) -> None:
        detections = self.detections
        _check_boxes(name, detections.boxes, detections.classes)
        _check_number_of_attributes(name, detections.boxes, detections.attributes)
        if unknown := set(detections.attributes) - _NAMES_OF_ATTRIBUTES:
            raise InputError(f'{name}: expected attributes of nuScenes, or ""; got {min(unknown)!r}.')
        scores = detections.scores
        if scores.shape != (len(detections.boxes),) or not np.isfinite(scores).all():
            raise InputError(
                f"{name}: expected one finite score per box; got scores of shape {scores.shape}, "
                f"{np.isfinite(scores).sum()} of them finite. Remove boxes without a score."
            )

    def _check_ground_truth(self, name: str) -> None:
        ground_truth = self.ground_truth
        _check_boxes(name, ground_truth.boxes, ground_truth.classes)
        if ground_truth.attributes is not None:
            _check_number_of_attributes(name, ground_truth.boxes, ground_truth.attributes)
        num_points = ground_truth.num_points
        if num_points is not None and num_points.shape != (len(ground_truth.boxes),):
            raise InputError(
                f"{name}: expected num_points of shape ({len(ground_truth.boxes)},), one number per box; got "
                f"{num_points.shape}. Use -1 for a box with an unknown number."
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


def _check_number_of_attributes(name: str, boxes: NDArray[np.floating], attributes: Sequence[str]) -> None:
    if len(attributes) != len(boxes):
        raise InputError(
            f"{name}: expected one attribute per box, {len(boxes)}; got {len(attributes)}. "
            'Use "" for a box without an attribute.'
        )
