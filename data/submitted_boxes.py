"""The boxes of one sample of a nuScenes submission, in the global frame."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ..runtime.detections import Detections
from ..runtime.geometry import quaternion_from_rotation, transform
from .results import FrameResult, result_boxes, rounded_boxes

Array = NDArray[np.float64]

SMALLEST_SIZE_M = 0.0001


@dataclass(frozen=True)
class SubmittedBoxes:
    """D boxes, in the order of the file.

    centres_m: (D, 3) in the global frame.
    sizes_wlh_m: (D, 3).
    rotations: (D, 4) quaternions, w first.
    velocities_m_s: (D, 2) along global x and y; NaN where unknown.
    scores: (D,).
    classes, attributes: D names; the attribute is "" for a box without one.
    maps, skipped: of `Detections`, if the boxes come from there.
    """

    centres_m: Array
    sizes_wlh_m: Array
    rotations: Array
    velocities_m_s: Array
    scores: Array
    classes: tuple[str, ...]
    attributes: tuple[str, ...]
    maps: Mapping[str, NDArray[np.float32]] = field(default_factory=dict)
    skipped: str | None = None

    @classmethod
    def of_detections(cls, detections: Detections, global_T_ego: Array) -> Self:
        """The boxes that a submission has for these detections. global_T_ego: (4, 4), the ego pose of their frame."""
        boxes, scores = rounded_boxes(detections)
        names = detections.classes, detections.attributes
        return cls(*_to_global(boxes, global_T_ego), scores, *names, detections.maps, detections.skipped)

    @classmethod
    def of_result(cls, result: FrameResult) -> Self:
        """The boxes that a submission has for a line of `results.jsonl`."""
        boxes, scores, classes, attributes = result_boxes(result)
        return cls(*_to_global(boxes, np.array(result["global_T_ego"])), scores, classes, attributes)

    def __len__(self) -> int:
        return len(self.classes)

    def __getitem__(self, rows: slice | NDArray) -> Self:
        """Select boxes by a slice, by row numbers or by a mask (D,)."""
        selected = np.arange(len(self))[rows]
        return replace(
            self,
            centres_m=self.centres_m[selected],
            sizes_wlh_m=self.sizes_wlh_m[selected],
            rotations=self.rotations[selected],
            velocities_m_s=self.velocities_m_s[selected],
            scores=self.scores[selected],
            classes=tuple(self.classes[row] for row in selected),
            attributes=tuple(self.attributes[row] for row in selected),
        )

    @cached_property
    def boxes(self) -> Array:
        """The boxes (D, 9) in the global frame: x y z w l h yaw vx vy."""
        return np.concatenate([self.centres_m, self.sizes_wlh_m, self.yaws_rad[:, None], self.velocities_m_s], axis=1)

    @property
    def yaws_rad(self) -> Array:
        """The direction (D,) of the x axis of each box, seen from above."""
        w, x, y, z = (self.rotations / np.linalg.norm(self.rotations, axis=1, keepdims=True)).T
        return np.arctan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))

    def to_json(self, token: str) -> list[dict[str, Any]]:
        """The boxes as a submission has them. token: of their sample."""
        arrays = self.centres_m, self.sizes_wlh_m, self.rotations, self.velocities_m_s
        columns = *(values.tolist() for values in arrays), self.classes, self.scores.tolist(), self.attributes
        keys = "translation", "size", "rotation", "velocity", "detection_name", "detection_score", "attribute_name"
        return [{"sample_token": token, **dict(zip(keys, row, strict=True))} for row in zip(*columns, strict=True)]


def _to_global(boxes: Array, global_T_ego: Array) -> tuple[Array, Array, Array, Array]:
    """Convert boxes (D, 9) of the ego frame to centres, sizes, rotations and velocities of the global frame.

    Positions, sizes and velocities have 4 decimals, as in results: 0.1 mm, a tenth of the unit of nuScenes'
    annotations. Rotations have 6, so a corner 5 m from the centre of its box moves by at most 0.01 mm.
    """
    # nuscenes-devkit refuses a size of 0, which a network's tiny box could have after rounding.
    sizes_wlh_m = np.maximum(_rounded(boxes[:, 3:6], 4), SMALLEST_SIZE_M)
    global_R_ego = global_T_ego[:3, :3]
    velocities_m_s = boxes[:, 7:9] @ global_R_ego[:2, :2].T
    rotations = _after_yaw(np.asarray(quaternion_from_rotation(global_R_ego)), boxes[:, 6])
    centres_m = transform(global_T_ego, boxes[:, :3])
    return _rounded(centres_m, 4), sizes_wlh_m, _rounded(rotations, 6), _rounded(velocities_m_s, 4)


def _after_yaw(quaternion: Array, yaws_rad: Array) -> Array:
    """The quaternions (D, 4) of rotations by yaws (D,), followed by the rotation of a quaternion (4,). w >= 0."""
    w, x, y, z = quaternion
    cos, sin = np.cos(yaws_rad / 2), np.sin(yaws_rad / 2)
    product = np.stack([w * cos - z * sin, x * cos + y * sin, y * cos - x * sin, z * cos + w * sin], axis=1)
    return np.where(product[:, :1] < 0, -product, product)


def _rounded(values: Array, decimals: int) -> Array:
    return np.round(values, decimals) + 0.0  # without the sign of -0.0
