"""What the predictions of one frame are judged by (paper, supplement, "Training Details").

Detection: focal loss on the classes and L1 on the pose vectors of matched queries, at every decoder layer. Map:
focal loss and dice loss (Sudre et al., 2017) for each predicted mask.
"""

import torch
from torch import Tensor

from ..model.decoder import Prediction
from ..model.pose_vectors import encode_boxes
from .focal_loss import focal_loss
from .hungarian_matching import Assignment, match_queries

CLASS_WEIGHT = 2.0  # Sparse4D's, as the paper follows it
BOX_WEIGHT = 0.25
POSE_WEIGHTS = (2.0, 2.0, 2.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
MASK_FOCAL_WEIGHT = 10.0
MASK_DICE_WEIGHT = 1.0

Losses = dict[str, Tensor]


def detection_losses(
    predictions: list[Prediction], boxes: Tensor, labels: Tensor, auxiliary_matches: int = 1
) -> Losses:
    """Losses by name, of every layer: `class_0`, `box_0`, ...; boxes (D, 9) and labels (D): the truth.

    auxiliary_matches: how many queries each object gets in the layers before the last (hybrid matching, Jia et al.,
    2023); in the last it is always one.
    """
    poses = encode_boxes(boxes)
    losses: Losses = {}
    for layer, prediction in enumerate(predictions):
        repeats = 1 if layer == len(predictions) - 1 else auxiliary_matches
        found = match_queries(prediction, poses, labels, repeats)
        losses[f"class_{layer}"] = CLASS_WEIGHT * class_loss(prediction.class_logits, labels, found)
        losses[f"box_{layer}"] = BOX_WEIGHT * box_loss(prediction.pose, poses, found)
    return losses


def class_loss(class_logits: Tensor, labels: Tensor, found: Assignment) -> Tensor:
    """Focal loss over all queries and classes, a matched query. class_logits (Q, classes); labels (D)."""
    targets = torch.zeros_like(class_logits)
    targets[found.queries, labels[found.objects]] = 1.0
    return focal_loss(class_logits, targets).sum() / max(1, len(found.queries))


def box_loss(pose: Tensor, poses: Tensor, found: Assignment) -> Tensor:
    """Weighted L1 distance of pose vectors, a matched query. pose (Q, 10); poses (D, 10): true ones, where numbers
    that are not known (NaN) count nothing.
    """
    expected = poses[found.objects]
    known = expected.isfinite()
    distance = (pose[found.queries] - expected.nan_to_num()).abs() * known * pose.new_tensor(POSE_WEIGHTS)
    return distance.sum() / max(1, len(found.queries))


def map_losses(maps: dict[str, Tensor], masks: Tensor) -> Losses:
    """Losses by name, `focal_lane_boundary`, ...; maps: logits (1, 1, X, Y) by class; masks (classes, X, Y) bool."""
    losses: Losses = {}
    for (name, logits), mask in zip(maps.items(), masks, strict=True):
        targets = mask.to(logits.dtype)
        losses[f"focal_{name}"] = MASK_FOCAL_WEIGHT * focal_loss(logits[0, 0], targets, alpha=0.5).mean()
        losses[f"dice_{name}"] = MASK_DICE_WEIGHT * dice_loss(logits[0, 0], targets)
    return losses


def dice_loss(logits: Tensor, mask: Tensor) -> Tensor:
    """1 - 2 |P ∩ M| / (|P| + |M|), with one cell added above and below, so that nothing found where nothing is
    is right. logits, mask (X, Y).
    """
    score = logits.sigmoid()
    return 1 - (2 * (score * mask).sum() + 1) / (score.sum() + mask.sum() + 1)
