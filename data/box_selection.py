"""Box selection: the ground-truth boxes of one frame that training, evaluation or clustering uses."""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..runtime.frame import GroundTruth
from .box_counts import BoxCounts, Reason
from .class_names import count_unknown, find_class, unknown_names_error
from .source import Source


@dataclass(frozen=True)
class BoxSelection:
    """The K selected boxes of a frame, and the numbers of those left out so far.

    ground_truth: all D annotated boxes.
    rows: (K,) row numbers of the selected boxes in `ground_truth`.
    classes: the classes of the K boxes.
    left_out: number of boxes by reason and annotated name.
    """

    ground_truth: GroundTruth
    rows: NDArray[np.int64]
    classes: tuple[str, ...]
    left_out: Counter[tuple[Reason, str]]

    @property
    def boxes(self) -> NDArray[np.float64]:
        """The boxes (K, 9), as in `GroundTruth.boxes`."""
        return self.ground_truth.boxes[self.rows]

    @property
    def attributes(self) -> tuple[str, ...] | None:
        """The attributes of the K boxes, as in `GroundTruth.attributes`."""
        attributes = self.ground_truth.attributes
        return None if attributes is None else tuple(attributes[row] for row in self.rows)

    @property
    def counts(self) -> BoxCounts:
        names = [self.ground_truth.classes[row] for row in self.rows]
        pairs = zip(names, self.classes, strict=True)
        return BoxCounts(Counter(self.classes), Counter(pair for pair in pairs if pair[0] != pair[1]), self.left_out)

    def keep(self, is_kept: NDArray[np.bool_], reason: Reason) -> "BoxSelection":
        """Leave out the boxes where `is_kept` (K,) is False, for this reason."""
        names = (self.ground_truth.classes[row] for row in self.rows[~is_kept])
        left_out = self.left_out + Counter((reason, name) for name in names)
        classes = tuple(name for name, kept in zip(self.classes, is_kept, strict=True) if kept)
        return replace(self, rows=self.rows[is_kept], classes=classes, left_out=left_out)

    def keep_observed(self) -> "BoxSelection":
        """Leave out the boxes that are known to hold no lidar or radar points, as nuScenes' benchmark does."""
        num_points = self.ground_truth.num_points
        return self if num_points is None else self.keep(num_points[self.rows] != 0, "no_points")


def select_boxes(ground_truth: GroundTruth, classes: Sequence[str], place: str = "ground truth") -> BoxSelection:
    """Select the boxes whose names stand for classes of the model, see `find_class`.

    classes: the classes of the model.
    place: where the boxes are, for the error.

    Raises InputError that lists the names which are not known.
    """
    names, mapping = ground_truth.classes, ground_truth.class_mapping
    if unknown := count_unknown(names, classes, mapping):
        raise unknown_names_error(place, unknown, classes, mapping)
    found = {name: find_class(name, classes, mapping) for name in dict.fromkeys(names)}
    rows = np.array([row for row, name in enumerate(names) if found[name] is not None], np.int64)
    selected = tuple(class_name for name in names if (class_name := found[name]) is not None)
    left_out: Counter[tuple[Reason, str]] = Counter(("class", name) for name in names if found[name] is None)
    return BoxSelection(ground_truth, rows, selected, left_out)


def known_ground_truth(source: Source, indices: Iterable[int]) -> Iterator[GroundTruth]:
    """Yield the ground truth of the frames whose boxes are known, without maps."""
    for index in indices:
        ground_truth = source.ground_truth_without_maps(index)
        if ground_truth is not None:
            yield ground_truth


def total_counts(selections: Iterable[BoxSelection]) -> BoxCounts:
    """Return the counts of all frames together."""
    return sum((selection.counts for selection in selections), BoxCounts())
