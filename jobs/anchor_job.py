"""Anchors from a source: the centres of its true boxes are clustered, and the centroids written to a file."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..data.anchor_clustering import DEFAULT_RANGE_M, centres_within_range, cluster_centres, ground_truth_centres
from ..data.anchors_file import SCHEMA_VERSION, Anchors, check_new_file, write_anchors
from ..runtime.progress import Progress, no_progress
from .notify import Notify, ignore
from .sources import open_source

MAX_SEED = 2**31 - 1  # OpenCV's generator takes a signed 32-bit integer


@dataclass(frozen=True)
class AnchorSummary:
    """The result of a clustering. rms_distance_m: root mean square distance of the boxes from their anchor."""

    file: Path
    num_queries: int
    num_boxes: int
    num_frames: int
    rms_distance_m: float

    def to_dict(self) -> dict[str, Any]:
        """The fields as JSON values."""
        return {
            "anchors": str(self.file),
            "queries": self.num_queries,
            "boxes": self.num_boxes,
            "frames": self.num_frames,
            "distance_m": self.rms_distance_m,
        }


def cluster_anchors(
    source: str | Path,
    num_queries: int,
    out: str | Path,
    *,
    range_m: float = DEFAULT_RANGE_M,
    seed: int = 0,
    progress: Progress = no_progress,
    notify: Notify = ignore,
) -> AnchorSummary:
    """Write the K-means centroids of the true boxes' centres, in the ego frame, to the new file `out`.

    source: a scene folder with true boxes, or `synthetic:SEED[:FRAMES]`.
    num_queries: the number of anchors, which is the model's number of queries.
    range_m: boxes farther from the ego are left out.
    seed: seed of the clustering, 0 to MAX_SEED.
    Raises InputError for a source with too few boxes, OutputError if the file exists or cannot be written.
    """
    file = Path(out)
    check_new_file(file)
    opened = open_source(source)
    centres = list(ground_truth_centres(opened, progress(range(len(opened)), "reading boxes")))
    points = centres_within_range(centres, num_queries, range_m)
    notify(f"clustering {len(points)} boxes ...")
    clusters = cluster_centres(points, num_queries, seed)
    anchors = Anchors(
        schema_version=SCHEMA_VERSION,
        centres_m=clusters.centroids.tolist(),
        source=opened.identity,
        num_frames=len(centres),
        num_boxes=len(points),
        range_m=range_m,
        seed=seed,
    )
    write_anchors(file, anchors)
    return AnchorSummary(file, num_queries, len(points), len(centres), clusters.rms_distance_m)
