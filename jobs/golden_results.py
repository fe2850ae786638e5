"""Compares the result line of a frame with the expected one."""

from typing import Any

import numpy as np

from ..data.results import FrameResult, result_boxes
from ..runtime.bundle.golden_record import ResultTolerance
from ..runtime.parity.tensor_error import box_difference
from ..runtime.printable import shortened

_MEASURED = {"boxes"}  # every other field is equal


def first_result_difference(expected: FrameResult, found: FrameResult, tolerance: ResultTolerance) -> str | None:
    """Compare two result lines; return the first difference as text, or None.

    Boxes are in the order of their scores. Two boxes may change places if their scores are equal within the tolerance,
    and a box with the lowest score may be another one.
    """
    for field in expected:
        if field not in _MEASURED and not _is_equal(expected[field], found[field]):
            return f"{field}: expected {shortened(expected[field])}; got {shortened(found[field])}"
    if len(expected["boxes"]) != len(found["boxes"]):
        return f"boxes: expected {len(expected['boxes'])}; got {len(found['boxes'])}"
    if tolerance.box is None or tolerance.score is None:
        return None
    return _first_box_difference(expected, found, tolerance.box, tolerance.score)


def _first_box_difference(
    expected: FrameResult, found: FrameResult, box_tolerance: float, score_tolerance: float
) -> str | None:
    wanted, boxes = result_boxes(expected), result_boxes(found)
    is_free = np.ones(len(wanted.scores), np.bool_)
    for index, (box, score, name) in enumerate(zip(boxes.boxes, boxes.scores, boxes.classes, strict=True)):
        expected_score = wanted.scores[index]
        if not abs(score - expected_score) <= score_tolerance:
            return f"boxes[{index}].score: expected {expected_score:g}; got {score:g}"
        difference = box_difference(wanted.boxes, box)
        is_match = is_free & (np.abs(wanted.scores - score) <= score_tolerance)
        is_match &= np.abs(difference).max(axis=1) <= box_tolerance
        is_match &= np.array([name == other for other in wanted.classes])
        matches = np.flatnonzero(is_match)
        if len(matches):
            is_free[matches[0]] = False
        elif score > wanted.scores[-1] + score_tolerance:
            descriptions = (_describe(result["boxes"][index]) for result in (expected, found))
            return "boxes[{}]: expected {}; got {}".format(index, *descriptions)
    return None


def _is_equal(expected: Any, found: Any) -> bool:
    """Whether two JSON values are equal; numbers may differ by rounding."""
    if isinstance(expected, dict) and isinstance(found, dict):
        return expected.keys() == found.keys() and all(_is_equal(expected[key], found[key]) for key in expected)
    if isinstance(expected, list) and isinstance(found, (list, tuple)):
        return len(expected) == len(found) and all(map(_is_equal, expected, found))
    if isinstance(expected, float) and isinstance(found, float):
        return abs(expected - found) <= 1e-6
    return bool(expected == found)


def _describe(box: dict[str, Any]) -> str:
    centre = ", ".join(f"{number:.2f}" for number in box["center_m"])
    return f"{box['class']} at ({centre}) with score {box['score']:g}"
