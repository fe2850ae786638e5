"""Reads a nuScenes submission file of any detector, sample by sample.

A submission for the validation split can have 1.2 GB. Only one sample is in memory at a time. The file is checked as
nuscenes-devkit 1.2.0 does (`EvalBox`, `DetectionBox`, `load_prediction`), and for what the devkit accepts silently:
a sample that occurs twice, a box of another sample, an infinite number, a rotation of length 0.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from ..runtime.detections import MAX_DETECTIONS
from ..runtime.errors import InputError
from ..runtime.files import check_regular_file
from ..runtime.json_record import describe_first_error
from ..runtime.printable import printable, shortened
from .json_stream import MAX_FILE_BYTES, JsonStream
from .nuscenes_submission import USABLE_DATA
from .submission_schema import SubmittedBox
from .submitted_boxes import SubmittedBoxes

META_FLAGS = frozenset(f"use_{name}" for name in USABLE_DATA)
_BOXES = TypeAdapter(list[SubmittedBox])


class SubmissionFile:
    """A submission file, which is read once.

    meta: the flags `use_camera` and so on of the file; None until they have been read.
    """

    def __init__(self, path: Path) -> None:
        """Raises InputError if there is no such regular file."""
        check_regular_file(path, MAX_FILE_BYTES, InputError)
        self.path = path
        self.meta: dict[str, bool] | None = None

    def __iter__(self) -> Iterator[tuple[str, SubmittedBoxes]]:
        """Yield the token and the boxes of each sample, in the order of the file.

        Raises InputError, naming the sample, the box and the field, for a file that the benchmark does not accept.
        """
        has_results = False
        with JsonStream(self.path) as stream:
            for key in stream.members():
                if key == "results":
                    if has_results:
                        raise self._error("field 'results': expected it once; got it twice. Remove one of them")
                    has_results = True
                    yield from self._samples(stream)
                elif key == "meta":
                    self._read_meta(stream)
                else:
                    stream.value()
            # Before the end of the file, because lines of results.jsonl are objects without these fields.
            if not has_results or self.meta is None:
                missing = "meta" if has_results else "results"
                raise self._error(
                    f"expected the fields 'meta' and 'results'; got no {missing!r}. Add it. The submission that "
                    "`run --format nuscenes` writes is results_nusc.json"
                )
            stream.check_end()

    def _read_meta(self, stream: JsonStream) -> None:
        meta = stream.value()
        if not isinstance(meta, dict):
            raise self._error(
                f"field 'meta': expected an object such as {{\"use_camera\": true}}; got {shortened(meta)}"
            )
        if self.meta is not None:
            raise self._error("field 'meta': expected it once; got it twice. Remove one of them")
        self.meta = {name: value for name, value in meta.items() if name in META_FLAGS}
        for name, value in self.meta.items():
            if not isinstance(value, bool):
                raise self._error(f"field 'meta.{name}': expected true or false; got {shortened(value)}")

    def _samples(self, stream: JsonStream) -> Iterator[tuple[str, SubmittedBoxes]]:
        seen: set[str] = set()
        for token in stream.members():
            if token in seen:
                raise self._error(
                    f"sample {shortened(token)}: expected each sample token once; got it twice. "
                    "Merge its lists of boxes"
                )
            seen.add(token)
            yield token, self._boxes(token, stream.value())

    def _boxes(self, token: str, entries: Any) -> SubmittedBoxes:
        """Check the boxes of one sample."""
        place = f"sample {shortened(token)}"
        if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
            raise self._error(f"{place}: expected a list of boxes, each an object; got {shortened(entries)}")
        if len(entries) > MAX_DETECTIONS:
            raise self._error(
                f"{place}: expected at most {MAX_DETECTIONS} boxes, the limit of nuScenes; got {len(entries)}. "
                "Keep those with the highest scores"
            )
        try:
            boxes = _BOXES.validate_python(entries)
        except ValidationError as failure:
            raise self._error(f"{place}, box {describe_first_error(failure)}") from None
        for number, box in enumerate(boxes):
            if box.sample_token != token:
                expected, got = shortened(token), shortened(box.sample_token)
                raise self._error(f"{place}, box {number}.sample_token: expected {expected}; got {got}")
        return _to_arrays([box for box in boxes if box.num_pts != 0])

    def _error(self, text: str) -> InputError:
        return InputError(f"{printable(str(self.path))}: {text}.")


def _to_arrays(boxes: list[SubmittedBox]) -> SubmittedBoxes:
    return SubmittedBoxes(
        centres_m=np.array([box.translation for box in boxes], np.float64).reshape(-1, 3),
        sizes_wlh_m=np.array([box.size for box in boxes], np.float64).reshape(-1, 3),
        rotations=np.array([box.rotation for box in boxes], np.float64).reshape(-1, 4),
        velocities_m_s=np.array([box.velocity for box in boxes], np.float64).reshape(-1, 2),
        scores=np.array([box.detection_score for box in boxes], np.float64),
        classes=tuple(box.detection_name for box in boxes),
        attributes=tuple(box.attribute_name for box in boxes),
    )
