"""Anchors from a source: the centres of its true boxes are clustered, and the centroids written to a file."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..data.anchor_clustering import DEFAULT_RANGE_M, centres_within_range, cluster_centres
from ..data.anchors_file import SCHEMA_VERSION, Anchors, check_new_file, write_anchors
from ..data.box_counts import BoxCounts
from ..data.box_selection import BoxSelection, known_ground_truth, select_boxes, total_counts
from ..data.class_names import DETECTION_CLASSES
from ..runtime.progress import Progress, no_progress
from .notify import Notify, ignore
from .sources import SourceNames, open_sources

MAX_SEED = 2**31 - 1  # OpenCV's generator takes a signed 32-bit integer


@dataclass(frozen=True)
class AnchorSummary:
    """The result of a clustering.

    num_boxes: boxes that were clustered.
    counts: numbers of boxes that were mapped to a class, and of those left out.
    rms_distance_m: root mean square distance of the boxes from their anchor.
    """

    file: Path
    num_queries: int
    num_boxes: int
    num_frames: int
    counts: BoxCounts
    rms_distance_m: float

    def to_dict(self) -> dict[str, Any]:
        """The fields as JSON values."""
        return {
            "anchors": str(self.file),
            "queries": self.num_queries,
            "boxes": self.num_boxes,
            "frames": self.num_frames,
            "ground_truth": self.counts.to_dict(),
            "distance_m": self.rms_distance_m,
        }


def cluster_anchors(
    sources: SourceNames,
    num_queries: int,
    out: str | Path,
    *,
    range_m: float = DEFAULT_RANGE_M,
    seed: int = 0,
    classes: Sequence[str] = DETECTION_CLASSES,
    progress: Progress = no_progress,
    notify: Notify = ignore,
) -> AnchorSummary:
    """Write the K-means centroids of the true boxes' centres, in the ego frame, to the new file `out`.

    sources: a scene folder with true boxes, or `synthetic:SEED[:FRAMES]`; or a list of sources.
    num_queries: the number of anchors, which is the model's number of queries.
    range_m: boxes farther from the ego are left out.
    seed: seed of the clustering, 0 to MAX_SEED.
    classes: the classes of the model. Boxes of other classes are left out.
    Raises InputError for a source with too few boxes or unknown class names, OutputError if the file exists or cannot
    be written.
    """
    file = Path(out)
    check_new_file(file)
    opened = open_sources(sources, progress=progress)
    opened.check_class_names(classes)
    known = known_ground_truth(opened, progress(range(len(opened)), "reading boxes"))
    selections = [select_boxes(ground_truth, classes).keep_observed() for ground_truth in known]
    counts = total_counts(_within_range(selection, range_m) for selection in selections)
    for line in counts.lines():
        notify(f"ground truth: {line}")
    points = centres_within_range([selection.boxes[:, :3] for selection in selections], num_queries, range_m)
    notify(f"clustering {len(points)} boxes ...")
    clusters = cluster_centres(points, num_queries, seed)
    anchors = Anchors(
        schema_version=SCHEMA_VERSION,
        centres_m=clusters.centroids.tolist(),
        source=opened.identity,
        num_frames=len(selections),
        num_boxes=len(points),
        range_m=range_m,
        seed=seed,
    )
    write_anchors(file, anchors)
    return AnchorSummary(file, num_queries, len(points), len(selections), counts, clusters.rms_distance_m)


def _within_range(selection: BoxSelection, range_m: float) -> BoxSelection:
    return selection.keep(np.linalg.norm(selection.boxes[:, :3], axis=1) <= range_m, "range")
