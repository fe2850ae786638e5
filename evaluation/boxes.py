"""Boxes of one kind, detected or true, of all samples one after the other, as arrays."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from ..data.nuscenes_submission import MOVING_M_S, attribute
from .protocol import CLASS_RANGES_M, CLASSES

ATTRIBUTES = tuple(
    dict.fromkeys(attribute(name, speed) for name in CLASSES for speed in (0.0, np.inf) if attribute(name, speed))
)
NO_ATTRIBUTE = -1
UNKNOWN = -1  # in place of a class that the benchmark does not have

_LABELS = {name: label for label, name in enumerate(CLASSES)}
_ATTRIBUTE_CODES = {"": NO_ATTRIBUTE} | {name: code for code, name in enumerate(ATTRIBUTES)}
_RANGES_M = np.array(list(CLASS_RANGES_M.values()))
_BY_MOTION = np.array(  # (classes, 2), standing and moving
    [[_ATTRIBUTE_CODES[attribute(name, speed)] for speed in (0.0, np.inf)] for name in CLASSES], np.int8
)


@dataclass(frozen=True)
class EvalBoxes:
    """D boxes, in the order of their samples and within one in the order they came in.

    sample: (D,) the number of each one's sample. label: (D,) indices into CLASSES.
    values: (D, 9) x y z w l h [m], yaw [rad], vx vy [m/s] in the ego frame of the sample.
    score: (D,) float; of true boxes without meaning. attribute: (D,) indices into ATTRIBUTES, or NO_ATTRIBUTE.
    """

    sample: NDArray[np.int32]
    label: NDArray[np.int8]
    values: NDArray[np.floating]
    score: NDArray[np.floating]
    attribute: NDArray[np.int8]

    def __len__(self) -> int:
        return len(self.sample)

    def __getitem__(self, rows: NDArray) -> "Boxes":
        """The boxes at these rows, indices or a mask."""
        return EvalBoxes(*(getattr(self, field.name)[rows] for field in fields(self)))

    @classmethod
    def none(cls) -> "Boxes":
        return cls.of(0, np.zeros((0, 9)), np.zeros(0), ())

    @classmethod
    def of(
        cls,
        sample: int,
        values: NDArray[np.floating],
        score: NDArray[np.floating],
        classes: Sequence[str],
        attributes: Sequence[str] | None = None,
    ) -> "Boxes":
        """The boxes of one sample that count: those of the benchmark's classes, within their ranges.

        attributes: by name, "" where there is none. Where None is given they follow from class and speed, by the rule
        by which a submission names them; an unknown speed (NaN) gives none.
        """
        label = np.array([_LABELS.get(name, UNKNOWN) for name in classes], np.int8)
        if attributes is None:
            codes = _likeliest_attributes(label, values[:, 7:9])
        else:
            codes = np.array([_ATTRIBUTE_CODES.get(name, len(ATTRIBUTES)) for name in attributes], np.int8)
        boxes = cls(np.full(len(label), sample, np.int32), label, values, score, codes)
        return boxes[(label != UNKNOWN) & (_distance_m(values[:, :2]) < _RANGES_M[label])]

    @classmethod
    def concatenated(cls, parts: Sequence["Boxes"]) -> "Boxes":
        parts = parts or [cls.none()]
        return cls(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(cls)))


def _likeliest_attributes(label: NDArray[np.int8], velocity: NDArray[np.floating]) -> NDArray[np.int8]:
    speed = _distance_m(velocity)
    codes = _BY_MOTION[label, (speed > MOVING_M_S).astype(np.int8)]
    return np.where(np.isnan(speed), NO_ATTRIBUTE, codes).astype(np.int8)


def _distance_m(vectors: NDArray[np.floating]) -> NDArray[np.float64]:
    """Lengths (D,) of vectors (D, 2)."""
    return np.sqrt(np.sum(vectors.astype(np.float64) ** 2, axis=1))
