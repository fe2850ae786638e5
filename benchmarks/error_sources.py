"""Error sources: the scores of a bundle when the ground truth corrects one kind of error in its detections.

    python -m benchmarks.error_sources out/scores/bundle synthetic:200 synthetic:201

The first table has a line per correction, the second one per range, and the third the headings of each class.
"""

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from duospacenet.evaluation import EvaluationReport, Sample, evaluate
from duospacenet.evaluation.protocol import CLASSES
from duospacenet.jobs.sources import open_source
from duospacenet.runtime import Detections, Pipeline
from duospacenet.runtime.frame import GroundTruth

FAR_M = 4.0  # a detection farther from an object than this does not belong to it
NEAR_M = 2.0
RANGES_M = (0, 10, 20, 30, 40, 75)
CONFIDENT = 0.3
FLIPPED_RAD = 2.6


@dataclass(frozen=True)
class DetectedFrame:
    """The detections and the ground truth of a frame, in the ego frame."""

    detections: Detections
    ground_truth: GroundTruth


Pair = tuple[int, int]  # index of a detection, index of an object
Correct = Callable[[DetectedFrame], DetectedFrame]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("bundle", type=Path)
    parser.add_argument("sources", nargs="+", help="sources with ground truth")
    options = parser.parse_args()
    frames = list(detect(Pipeline.load(options.bundle), options.sources))
    print("| corrected | mAP | NDS |\n| --- | --- | --- |")
    for name, correct in CORRECTIONS.items():
        print(f"| {name} | {describe(score(map(correct, frames)))} |")
    print("\n| range [m] | mAP | NDS |\n| --- | --- | --- |")
    for lower, upper in pairwise(RANGES_M):
        print(f"| {lower} to {upper} | {describe(score(map(partial(within, lower_m=lower, upper_m=upper), frames)))} |")
    print("\n| class | true boxes per frame | flipped headings |\n| --- | --- | --- |")
    for name in CLASSES:
        count = sum(frame.ground_truth.classes.count(name) for frame in frames) / len(frames)
        print(f"| {name} | {count:.1f} | {flipped_share(frames, name):.2f} |")


def detect(pipeline: Pipeline, sources: list[str]) -> Iterator[DetectedFrame]:
    """Run the bundle over all sources. The history is reset between them."""
    for name in sources:
        stream = pipeline.stream()
        for frame in open_source(name):
            assert frame.ground_truth is not None
            yield DetectedFrame(stream.step(frame), frame.ground_truth)


def score(frames: Iterator[DetectedFrame]) -> EvaluationReport:
    return evaluate(Sample(frame.detections, frame.ground_truth) for frame in frames)


def describe(report: EvaluationReport) -> str:
    return f"{report.mean_average_precision:.3f} | {report.nds:.3f}"


# --- Corrections --------------------------------------------------------------------------------------------------


def match(frame: DetectedFrame, distance_m: float, same_class: bool = True) -> list[Pair]:
    """Match detections, in descending order of score, with the nearest object that is not taken yet."""
    detections, distances_m = frame.detections, distances(frame, same_class)
    pairs: list[Pair] = []
    for detection in np.argsort(-detections.scores, kind="stable").tolist():
        if distances_m.shape[1] and distances_m[detection].min() < distance_m:
            nearest = int(distances_m[detection].argmin())
            pairs.append((detection, nearest))
            distances_m[:, nearest] = np.inf
    return pairs


def distances(frame: DetectedFrame, same_class: bool = True) -> NDArray[np.float64]:
    """The distance in x and y of each detection to each object [m]; infinite if their classes differ."""
    detected, true = frame.detections, frame.ground_truth
    offsets = detected.boxes[:, None, :2] - true.boxes[None, :, :2]
    differ = np.array(detected.classes, object)[:, None] != np.array(true.classes, object)[None]
    return np.where(differ & same_class, np.inf, np.linalg.norm(offsets.astype(np.float64), axis=2))


def with_true_values(frame: DetectedFrame, columns: slice) -> DetectedFrame:
    """Replace columns of the boxes by those of their objects."""
    boxes = frame.detections.boxes.copy()
    for detection, true in match(frame, FAR_M):
        boxes[detection, columns] = frame.ground_truth.boxes[true, columns]
    return change(frame, boxes=boxes)


def with_true_classes(frame: DetectedFrame) -> DetectedFrame:
    classes = list(frame.detections.classes)
    for detection, true in match(frame, FAR_M, same_class=False):
        classes[detection] = frame.ground_truth.classes[true]
    return change(frame, classes=tuple(classes))


def without_duplicates(frame: DetectedFrame) -> DetectedFrame:
    """Remove the detections near an object of their class that have no object, because better ones took it."""
    is_near = distances(frame).min(axis=1, initial=np.inf) < NEAR_M
    matched = {detection for detection, _ in match(frame, NEAR_M)}
    return select(frame, [not near or index in matched for index, near in enumerate(is_near)])


def without_false_positives(frame: DetectedFrame) -> DetectedFrame:
    """Remove the detections that are not near an object of their class. Duplicates stay."""
    return select(frame, (distances(frame).min(axis=1, initial=np.inf) < NEAR_M).tolist())


CORRECTIONS: dict[str, Correct] = {
    "nothing": lambda frame: frame,
    f"positions (of detections within {FAR_M:g} m)": partial(with_true_values, columns=slice(0, 2)),
    "headings": partial(with_true_values, columns=slice(6, 7)),
    "velocities": partial(with_true_values, columns=slice(7, 9)),
    f"classes (of detections within {FAR_M:g} m)": with_true_classes,
    "duplicates": without_duplicates,
    f"false positives (farther than {NEAR_M:g} m from objects of their class)": without_false_positives,
}


# --- Selections ---------------------------------------------------------------------------------------------------


def within(frame: DetectedFrame, lower_m: float, upper_m: float) -> DetectedFrame:
    """The detections and objects at a distance from `lower_m` to below `upper_m` in x and y."""
    detected_m, true_m = (np.linalg.norm(side.boxes[:, :2], axis=1) for side in (frame.detections, frame.ground_truth))
    kept = np.flatnonzero((true_m >= lower_m) & (true_m < upper_m))
    truth = frame.ground_truth
    objects = GroundTruth(
        truth.boxes[kept],
        tuple(truth.classes[index] for index in kept),
        num_points=None if truth.num_points is None else truth.num_points[kept],
        attributes=None if truth.attributes is None else tuple(truth.attributes[index] for index in kept),
        class_mapping=truth.class_mapping,
    )
    selected = select(frame, ((detected_m >= lower_m) & (detected_m < upper_m)).tolist())
    return replace(selected, ground_truth=objects)


def select(frame: DetectedFrame, kept: list[bool]) -> DetectedFrame:
    """The frame with some of its detections."""
    detections, rows = frame.detections, np.flatnonzero(kept)
    return change(
        frame,
        boxes=detections.boxes[rows],
        scores=detections.scores[rows],
        classes=tuple(detections.classes[row] for row in rows),
        queries=detections.queries[rows],
    )


def change(frame: DetectedFrame, **values: Any) -> DetectedFrame:
    """The frame with other values of its detections. Their attributes follow from the new classes and velocities."""
    return replace(frame, detections=replace(frame.detections, attributes=None, **values))


def flipped_share(frames: list[DetectedFrame], name: str) -> float:
    """The share of confident detections of a class near an object that have nearly the opposite heading."""
    turns = [
        frame.detections.boxes[detection, 6] - frame.ground_truth.boxes[true, 6]
        for frame in frames
        for detection, true in match(frame, NEAR_M)
        if frame.detections.scores[detection] > CONFIDENT and frame.detections.classes[detection] == name
    ]
    differences = np.abs((np.array(turns) + np.pi) % (2 * np.pi) - np.pi)
    return float(np.mean(differences > FLIPPED_RAD)) if turns else float("nan")


if __name__ == "__main__":
    main()
