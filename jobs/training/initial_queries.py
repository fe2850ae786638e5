"""The queries before the first step of a training: at anchors from a file, or clustered from the ground truth."""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from ...runtime.frame import GroundTruth
from ..models import checkpoint_errors, read_centres
from ..notify import Notify

if TYPE_CHECKING:
    from torch import Tensor

    from ...model import DuoSpaceNet
    from ...training import Settings


def place_queries(
    model: "DuoSpaceNet",
    settings: "Settings",
    ground_truth: Iterable[GroundTruth],
    anchors: Path | None,
    notify: Notify,
) -> None:
    """Set the initial poses of the queries of `model`, in place.

    anchors: a file of `duospacenet anchors`, with positions; or Sparse4D's anchors, with whole poses: its .npy file or
        a checkpoint. None clusters the boxes of `ground_truth`.

    Raises ArtifactError for an anchors file that does not fit, InputError if there are too few boxes to cluster.
    """
    import torch

    from ...model.queries import place_anchors
    from ...training.initial_anchors import find_initial_anchors, mean_box_size

    config = model.config
    if anchors is not None and not _is_json(anchors):
        with torch.no_grad():
            model.queries.pose.copy_(_read_sparse4d(anchors, config.num_queries))
        notify(f"{anchors}: {config.num_queries} anchors of Sparse4D, moved from the lidar frame to the ego frame")
        return
    ground_truth = list(ground_truth)
    if anchors is None:
        notify("clustering anchors ...")
        centres = find_initial_anchors(ground_truth, config.num_queries, settings.seed, config.classes)
    else:
        centres = torch.from_numpy(read_centres(anchors, config))
        notify(f"{anchors}: {config.num_queries} anchors")
    place_anchors(model.queries.pose, centres)
    if settings.anchor_size == "mean":
        _resize(model, mean_box_size(ground_truth, config.classes), notify)


def _resize(model: "DuoSpaceNet", size_m: "Tensor | None", notify: Notify) -> None:
    """Set the size of all queries. Without a size, as in a training of the maps alone, it stays that of a car."""
    from ...model.queries import resize_anchors

    if size_m is None:
        notify("anchors: no true box is near enough to give their size, so they have that of a car")
    else:
        resize_anchors(model.queries.pose, size_m)


def _read_sparse4d(path: Path, num_queries: int) -> "Tensor":
    from ...weights.sparse4d_anchors import read_sparse4d_anchors

    with checkpoint_errors():
        return read_sparse4d_anchors(path, num_queries)


def _is_json(path: Path) -> bool:
    """Whether a file starts as the JSON of an anchors file does."""
    if not path.is_file():
        return False  # the error is that of a checkpoint
    with path.open("rb") as file:
        return file.read(64).lstrip().startswith(b"{")
