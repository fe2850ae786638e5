"""Detected or ground-truth boxes of all samples, concatenated into arrays."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from ..runtime.attributes import ATTRIBUTES, likely_attributes
from .protocol import CLASS_RANGES_M, CLASSES

NO_ATTRIBUTE = -1
UNKNOWN_CLASS = -1  # label of classes that are not in the benchmark

_LABELS = {name: label for label, name in enumerate(CLASSES)}
_ATTRIBUTE_CODES = {"": NO_ATTRIBUTE} | {name: code for code, name in enumerate(ATTRIBUTES)}
_RANGES_M = np.array(list(CLASS_RANGES_M.values()))


@dataclass(frozen=True)
class EvalBoxes:
    """D boxes, ordered by sample, and within a sample in input order.

    sample: (D,) sample numbers.
    label: (D,) indices into CLASSES.
    values: (D, 9) x y z w l h [m], yaw [rad], vx vy [m/s], in the frame of the sample.
    score: (D,) detection scores; unused for ground truth.
    attribute: (D,) indices into ATTRIBUTES, or NO_ATTRIBUTE.
    """

    sample: NDArray[np.int32]
    label: NDArray[np.int8]
    values: NDArray[np.floating]
    score: NDArray[np.floating]
    attribute: NDArray[np.int8]

    def __len__(self) -> int:
        return len(self.sample)

    def __getitem__(self, rows: NDArray) -> "EvalBoxes":
        """Select boxes by row indices or by a mask."""
        return EvalBoxes(*(getattr(self, field.name)[rows] for field in fields(self)))

    @classmethod
    def empty(cls) -> "EvalBoxes":
        """No boxes."""
        return cls.of_sample(0, np.zeros((0, 9)), np.zeros(0), ())

    @classmethod
    def of_sample(
        cls,
        sample: int,
        values: NDArray[np.floating],
        score: NDArray[np.floating],
        classes: Sequence[str],
        attributes: Sequence[str] | None = None,
        ego_m: NDArray[np.float64] | None = None,
    ) -> "EvalBoxes":
        """The boxes of one sample, without those of unknown classes and those beyond the range of their class.

        sample: number of the sample.
        values: (D, 9) as in the class.
        score: (D,).
        classes: D class names.
        attributes: D attribute names, "" for no attribute. None derives them from class and speed, by the same rule as
            for detections. A box of unknown speed (NaN) then has no attribute.
        ego_m: (3,) position of the ego, in the frame of the boxes; None for the origin.
        """
        label = np.array([_LABELS.get(name, UNKNOWN_CLASS) for name in classes], np.int8)
        if attributes is None:
            attributes = likely_attributes(classes, values[:, 7:9])
        # All unknown attribute names get one more code, which never equals that of a detection.
        codes = np.array([_ATTRIBUTE_CODES.get(name, len(ATTRIBUTES)) for name in attributes], np.int8)
        boxes = cls(np.full(len(label), sample, np.int32), label, values, score, codes)
        distances_m = planar_norms(values[:, :2] if ego_m is None else values[:, :2] - ego_m[:2])
        return boxes[(label != UNKNOWN_CLASS) & (distances_m < _RANGES_M[label])]

    @classmethod
    def concatenate(cls, parts: Sequence["EvalBoxes"]) -> "EvalBoxes":
        """The boxes of all parts, in order."""
        parts = parts or [cls.empty()]
        return cls(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(cls)))


def planar_norms(vectors: NDArray[np.floating]) -> NDArray[np.float64]:
    """Lengths (D,) of vectors (D, 2), in float64 as in the devkit. In float32 a box could cross a class range."""
    return np.sqrt(np.sum(vectors.astype(np.float64) ** 2, axis=1))
