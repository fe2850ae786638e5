"""Sensitivity: the error of the detections when a single block is quantized, and the rest is float32."""

import csv
import io
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...runtime.detections import sigmoid
from ...runtime.files import write_atomically
from .candidate import Block

SENSITIVITY_NAME = "sensitivity.csv"
_COLUMNS = ("graph", "block", "operators", "error", "score_error", "position_error_m", "map_error", "precision")

Outputs = Mapping[str, NDArray[np.float32]]  # class_logits (Q, classes), boxes (Q, 9) and maps (1, 1, X, Y), by name


@dataclass(frozen=True)
class Sensitivity:
    """The error of the outputs when only `block` is quantized.

    score_error: RMS difference of the scores, divided by the RMS of the float32 scores.
    position_error_m: mean distance of the boxes' centres [m], weighted with the float32 scores.
    map_error: mean absolute difference of the map probabilities.
    """

    block: Block
    score_error: float
    position_error_m: float
    map_error: float

    @property
    def error(self) -> float:
        """The three errors as one number, by which the blocks are ranked. nuScenes matches boxes within 2 m."""
        return self.score_error + self.position_error_m / 2 + self.map_error

    @classmethod
    def between(cls, block: Block, reference: Sequence[Outputs], outputs: Iterable[Outputs]) -> "Sensitivity":
        """Compare the outputs of some frames with those of the float32 bundle."""
        errors = [_errors(expected, actual) for expected, actual in zip(reference, outputs, strict=True)]
        return cls(block, *(float(value) for value in np.mean(errors, axis=0)))


def write_sensitivity(folder: Path, rows: Iterable[Sensitivity], quantized: Collection[Block]) -> None:
    """Write one line per block, most sensitive first. quantized: the blocks that are int8 in the bundle."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for row in sorted(rows, key=lambda row: row.error, reverse=True):
        errors = (row.error, row.score_error, row.position_error_m, row.map_error)
        precision = "int8" if row.block in quantized else "float32"
        writer.writerow([row.block.graph, row.block.name, row.block.nodes, *(f"{e:.6g}" for e in errors), precision])
    write_atomically(folder / SENSITIVITY_NAME, file.getvalue().encode())


def _errors(reference: Outputs, outputs: Outputs) -> tuple[float, float, float]:
    """The score error, the position error [m] and the map error of one frame."""
    scores, expected = sigmoid(outputs["class_logits"]), sigmoid(reference["class_logits"])
    score_error = np.linalg.norm(scores - expected) / np.linalg.norm(expected)
    distances_m = np.linalg.norm(outputs["boxes"][:, :3] - reference["boxes"][:, :3], axis=1)
    position_error_m = np.average(distances_m, weights=expected.max(axis=1))
    maps = [name for name in reference if name not in ("class_logits", "boxes")]
    differences = [np.abs(sigmoid(outputs[name]) - sigmoid(reference[name])).mean() for name in maps]
    return float(score_error), float(position_error_m), float(np.mean(differences)) if maps else 0.0
