"""Validation scores: how good the model is on held-out sources after a number of steps."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from ...evaluation import EvaluationReport


class Quality(NamedTuple):
    """The score that selects the best weights. name: "NDS", or "mean map IoU" if no boxes were evaluated."""

    name: str
    value: float


@dataclass(frozen=True)
class ValidationScores:
    """The scores of one validation. None: not defined, or not evaluated.

    step: completed steps.
    data: the identities of the sources.
    mean_average_precision: mAP, 0 to 1.
    nds: the nuScenes detection score, 0 to 1.
    velocity_error: mAVE [m/s].
    map_iou: intersection over union by map class, 0 to 1; empty if no maps were evaluated.
    """

    step: int
    data: str
    mean_average_precision: float | None
    nds: float | None
    velocity_error: float | None
    map_iou: Mapping[str, float | None] = field(default_factory=dict)

    @classmethod
    def of_report(cls, step: int, data: str, report: EvaluationReport) -> "ValidationScores":
        """The scores of an evaluation."""
        return cls(
            step,
            data,
            _known(report.mean_average_precision),
            _known(report.nds),
            _known(report.mean_errors["velocity"]),
            {name: _known(value) for name, value in report.map_iou.items()},
        )

    @property
    def quality(self) -> Quality:
        """The score that selects the best weights: NDS, or the mean IoU of the maps if no boxes were evaluated.

        A map class with an undefined IoU counts as 0, so that the number of classes never changes.
        """
        if self.nds is not None:
            return Quality("NDS", self.nds)
        return Quality("mean map IoU", math.fsum(iou or 0.0 for iou in self.map_iou.values()) / len(self.map_iou))

    def scores(self) -> dict[str, float]:
        """The defined scores in one dictionary, for a curve each: mAP, NDS, mAVE and `IoU CLASS`."""
        named = {"mAP": self.mean_average_precision, "NDS": self.nds, "mAVE": self.velocity_error}
        named |= {f"IoU {name}": iou for name, iou in self.map_iou.items()}
        return {name: value for name, value in named.items() if value is not None}

    def describe(self) -> str:
        """The scores in one line, for example "mAP 0.412, NDS 0.466, mAVE 1.20 m/s, IoU drivable area 0.812"."""
        texts = [f"{name} {value:.3f}" for name, value in self.scores().items()]
        return ", ".join(f"{text} m/s" if text.startswith("mAVE") else text.replace("_", " ") for text in texts)

    def to_dict(self) -> dict[str, Any]:
        """The line of the log."""
        values = {"mAP": self.mean_average_precision, "NDS": self.nds, "mAVE": self.velocity_error}
        return {"step": self.step, "validation": {**values, "map_iou": dict(self.map_iou), "data": self.data}}

    @classmethod
    def from_dict(cls, line: Mapping[str, Any]) -> "ValidationScores":
        """The inverse of `to_dict`. Raises ValueError for a line with other fields."""
        try:
            values = line["validation"]
            scores = cls(
                line["step"], values["data"], values["mAP"], values["NDS"], values["mAVE"], dict(values["map_iou"])
            )
            if not math.isfinite(scores.quality.value):
                raise ValueError("scores that are not finite")
        except (KeyError, TypeError, ZeroDivisionError) as error:
            raise ValueError(f"a validation without scores ({error!r})") from error
        return scores


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None
