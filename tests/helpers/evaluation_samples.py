"""Random samples for evaluation tests, with ties, duplicates, missing attributes and unknown velocities."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from duospacenet.evaluation import Sample
from duospacenet.runtime import Detections, GroundTruth
from duospacenet.runtime.detections import HistoryReport

Array = NDArray[np.float64]

CLASSES = ("car", "truck", "bus", "trailer", "pedestrian", "motorcycle", "bicycle", "traffic_cone", "barrier")
SHARES = np.array(
    [0.3, 0.1, 0.05, 0.0, 0.25, 0.05, 0.05, 0.1, 0.1]
)  # of the true boxes: no trailer, though some are detected
DETECTED_SHARES = {"bus": 0.0, "bicycle": 0.06}  # of the classes that are rarely detected
ATTRIBUTES = {  # of the classes that get attributes here
    "car": ("vehicle.parked", "vehicle.moving"),
    "pedestrian": ("pedestrian.standing", "pedestrian.moving", "pedestrian.sitting_lying_down"),
    "motorcycle": ("cycle.with_rider", "cycle.without_rider"),
}


def make_detections(
    boxes: Sequence | Array, scores: Sequence | Array, classes: Sequence[str], **maps: Array
) -> Detections:
    return Detections(
        boxes=np.array(boxes, np.float32).reshape(-1, 9),
        scores=np.array(scores, np.float32),
        classes=tuple(classes),
        queries=np.arange(len(classes)),
        history=HistoryReport(1),
        maps=maps,
    )


def make_ground_truth(
    boxes: Sequence | Array, classes: Sequence[str], attributes: Sequence[str] | None = None, **maps: NDArray[np.bool_]
) -> GroundTruth:
    known = None if attributes is None else tuple(attributes)
    array = np.array(boxes, np.float64).reshape(-1, 9)
    return GroundTruth(boxes=array, classes=tuple(classes), attributes=known, maps=maps)


def box(x: float = 10.0, y: float = 0.0, size: Sequence[float] = (2, 4, 1.5), yaw: float = 0.0, v: Sequence = (0, 0)):
    """The nine numbers of one box."""
    return [x, y, 0.0, *size, yaw, *v]


def random_sample(rng: np.random.Generator, num_true: int = 14, num_false: int = 10) -> Sample:
    """A sample with displaced copies of the true boxes as detections, and random false positives.

    Some true boxes are detected twice or not at all. Scores repeat. Some true boxes have no attribute or an unknown
    velocity. Some boxes are beyond the range of their class.
    """
    classes = [str(name) for name in rng.choice(CLASSES, num_true, p=SHARES)]
    ground_truth = _random_boxes(rng, num_true)
    attributes = [str(rng.choice(ATTRIBUTES.get(name, ("",)))) if rng.random() < 0.9 else "" for name in classes]
    share = np.array([DETECTED_SHARES.get(name, 0.9) for name in classes])
    times = np.where(rng.random(num_true) < share, 1 + (rng.random(num_true) < 0.2), 0)
    displaced = np.repeat(ground_truth, times, axis=0)
    displaced += rng.normal(size=displaced.shape) * [0.6, 0.6, 0.2, 0.1, 0.3, 0.1, 0.4, 0.3, 0.3]
    displaced[:, 3:6] = np.maximum(displaced[:, 3:6], 0.1)
    names = list(np.repeat(classes, times)) + list(rng.choice(CLASSES, num_false))
    boxes = np.concatenate([displaced, _random_boxes(rng, num_false)])
    scores = np.round(rng.beta(2, 3, len(boxes)), 2)
    scores[: len(displaced)] = np.round(np.sqrt(scores[: len(displaced)]), 2)
    ground_truth[rng.random(num_true) < 0.1, 7:9] = np.nan
    return Sample(make_detections(boxes, scores, names), make_ground_truth(ground_truth, classes, attributes))


def _random_boxes(rng: np.random.Generator, count: int) -> Array:
    boxes = np.zeros((count, 9))
    boxes[:, :2] = rng.uniform(-40, 40, (count, 2))
    boxes[:, 3:6] = rng.uniform((0.5, 0.5, 1), (2.5, 6, 3), (count, 3))
    boxes[:, 6] = rng.uniform(-np.pi, np.pi, count)
    boxes[:, 7:9] = rng.normal(size=(count, 2)) * rng.choice([0, 0.2, 5], (count, 1))
    return boxes
