"""Writes the results of a run as a nuScenes submission file, the input of the nuScenes detection benchmark."""

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..runtime.detections import MAX_DETECTIONS
from ..runtime.errors import InputError, UsageError
from ..runtime.files import atomic_path
from .results import FrameResult
from .submitted_boxes import SubmittedBoxes

USABLE_DATA = ("camera", "lidar", "radar", "map", "external")  # the flags of `meta` are `use_camera` and so on


@dataclass(frozen=True)
class SubmissionOptions:
    """What a submission holds.

    uses: the data that the results are based on, of USABLE_DATA; they become the flags of `meta`.
    max_boxes: number of boxes per sample, those with the highest scores.
    min_score: boxes with a lower score are left out.
    """

    uses: tuple[str, ...] = ("camera",)
    max_boxes: int = MAX_DETECTIONS
    min_score: float = 0.0

    def check(self) -> None:
        """Raise UsageError for an option that no submission can have."""
        if unknown := [name for name in self.uses if name not in USABLE_DATA]:
            raise UsageError(f"--submission-uses: expected some of {', '.join(USABLE_DATA)}; got {unknown[0]!r}.")
        if not 1 <= self.max_boxes <= MAX_DETECTIONS:
            raise UsageError(
                f"--submission-max-boxes: expected 1 to {MAX_DETECTIONS}, the limit of nuScenes; got {self.max_boxes}."
            )
        if not 0 <= self.min_score <= 1:
            raise UsageError(f"--submission-min-score: expected 0 to 1; got {self.min_score}.")

    def meta(self) -> dict[str, bool]:
        """Return the object `meta` of the submission."""
        return {f"use_{name}": name in self.uses for name in USABLE_DATA}

    def select(self, boxes: SubmittedBoxes) -> SubmittedBoxes:
        """Return the boxes that the submission holds. boxes: highest score first, as in results."""
        return boxes[boxes.scores >= self.min_score][: self.max_boxes]


def write_submission(path: Path, results: Iterable[FrameResult], options: SubmissionOptions | None = None) -> None:
    """Write a submission file, completely or not at all. By default it holds all boxes.

    Boxes are converted to the global frame. A skipped frame has an empty list of boxes, because nuScenes requires every
    sample. Results have at most 500 boxes, which is the limit of nuScenes.

    Raises OutputError if the file cannot be written.
    """
    options = options or SubmissionOptions()
    # Each sample is written on its own, because the results of a whole data set may not fit in memory.
    with atomic_path(path) as temporary, temporary.open("w", encoding="utf-8") as file:
        file.write(f'{{"meta":{_to_json(options.meta())},"results":{{')
        for number, result in enumerate(results):
            boxes = options.select(SubmittedBoxes.of_result(result)).to_json(result["token"])
            comma = "," if number else ""
            file.write(f"{comma}\n{_to_json(result['token'])}:{_to_json(boxes)}")
        file.write("\n}}\n")


def check_sample_tokens(tokens: Iterable[str]) -> None:
    """Check that every frame has a unique token, the key of its sample in a submission. Raises InputError."""
    seen: set[str] = set()
    for number, token in enumerate(tokens):
        if not token or token in seen:
            got = f"{token!r} for the second time" if token else "no token"
            raise InputError(
                f"frame {number}: expected a sample token for the nuScenes format; got {got}. "
                "Give every frame of the source its own token."
            )
        seen.add(token)


def _to_json(value: Any) -> str:
    return json.dumps(value, allow_nan=False, separators=(",", ":"))
