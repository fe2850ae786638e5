"""Sizes of ground-truth boxes, compared with the usual sizes of their classes: order and unit."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import permutations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .findings import Finding, Verdict
from .labelled_frame import LabelledFrame

Array = NDArray[np.float64]

USUAL_SIZES_M = {  # width, length, height
    "car": (1.95, 4.62, 1.73),
    "truck": (2.5, 6.9, 2.8),
    "construction_vehicle": (2.7, 6.4, 3.1),
    "bus": (2.9, 11.0, 3.5),
    "trailer": (2.9, 11.5, 3.8),
    "barrier": (2.4, 0.5, 1.0),
    "motorcycle": (0.8, 2.1, 1.5),
    "bicycle": (0.6, 1.7, 1.3),
    "pedestrian": (0.67, 0.72, 1.75),
    "traffic_cone": (0.4, 0.4, 1.0),
}
SPREAD = 0.3  # of the logarithms of sizes within a class
LARGEST_COST = 9.0  # of one box
LEAST_GAIN = 20.0  # in total; five cars with exchanged width and length give 40
LEAST_SHARE = 0.7  # of the boxes with another cost must have a smaller one
LARGEST_MEAN_COST = 5.0  # of an explanation
UNITS_M = {"metres": 1.0, "centimetres": 0.01, "millimetres": 0.001, "feet": 0.3048, "half lengths": 2.0}
NAMES = ("width", "length", "height")

CORRECT_SIZES = "Give size_wlh_m in metres, as width, length, height. The length is along the heading."


class SizeMistake(NamedTuple):
    """order: positions of width, length and height in the given numbers. metres: per unit of the given numbers."""

    order: tuple[int, int, int]
    unit: str

    @property
    def cause(self) -> str:
        """The mistake, as a sentence."""
        parts = [] if self.unit == "metres" else [f"the sizes are in {self.unit} instead of metres"]
        if self.order == (1, 0, 2):
            parts.append("width and length are exchanged")
        elif self.order != (0, 1, 2):
            given = [NAMES[self.order.index(position)] for position in range(3)]
            parts.append(f"the sizes are in the order {', '.join(given)}")
        return f"Likely cause: {' and '.join(parts)}."


def size_findings(frames: Iterable[LabelledFrame]) -> Iterator[Finding]:
    """Yield a finding if another order or unit of the sizes fits the classes much better."""
    sizes, usual, indices = _known_sizes(frames)
    if not len(sizes):
        return
    given = _costs(sizes, usual, SizeMistake((0, 1, 2), "metres"))
    costs = {mistake: _costs(sizes, usual, mistake) for mistake in _mistakes()}
    best = min(costs, key=lambda mistake: costs[mistake].sum())
    differs = costs[best] != given
    is_smaller = costs[best][differs] < given[differs]
    if given.sum() - costs[best].sum() < LEAST_GAIN or costs[best].mean() > LARGEST_MEAN_COST:
        return
    if is_smaller.mean() < LEAST_SHARE:
        return
    example = int(np.argmax(given - costs[best]))
    yield Finding(
        "sizes",
        Verdict.SUSPECT,
        "sizes that are usual for the classes",
        f"{_describe(sizes[example])}, for example; {int(is_smaller.sum())} of {len(sizes)} boxes fit better otherwise",
        best.cause,
        CORRECT_SIZES,
        indices[example],
        len(set(indices)),
    )


def _known_sizes(frames: Iterable[LabelledFrame]) -> tuple[Array, Array, list[int]]:
    """The sizes (K, 3), the usual sizes of their classes (K, 3), and the frames of all boxes of known classes."""
    rows = [
        (box[3:6], USUAL_SIZES_M[name], frame.index)
        for frame in frames
        for box, name in zip(frame.boxes, frame.classes, strict=True)
        if name is not None
    ]
    sizes, usual, indices = zip(*rows, strict=True) if rows else ((), (), ())
    return np.array(sizes, np.float64).reshape(-1, 3), np.array(usual, np.float64).reshape(-1, 3), list(indices)


def _mistakes() -> Iterator[SizeMistake]:
    for unit in UNITS_M:
        for order in permutations(range(3)):
            yield SizeMistake((order[0], order[1], order[2]), unit)


def _costs(sizes: Array, usual: Array, mistake: SizeMistake) -> Array:
    """The costs (K,) of sizes after undoing a mistake."""
    corrected = sizes[:, list(mistake.order)] * UNITS_M[mistake.unit]
    return np.minimum(((np.log(corrected / usual) / SPREAD) ** 2).sum(axis=1), LARGEST_COST)


def _describe(size: Sequence[float]) -> str:
    return " x ".join(f"{value:.4g}" for value in size)
