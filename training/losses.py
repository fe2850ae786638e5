"""Detection and map losses of one frame (paper, supplement, "Training Details").

Detection: at every decoder layer, the focal loss on the classes and L1 on the pose vectors of matched queries.
Map: the focal loss and the dice loss (Sudre et al., 2017) of each predicted mask.
"""

import torch
from torch import Tensor

from ..model.decoder import Prediction
from ..model.pose_vectors import encode_boxes
from .focal_loss import focal_loss
from .hungarian_matching import Assignment, match_queries

# The weights of Sparse4D, which the paper follows.
CLASS_WEIGHT = 2.0
BOX_WEIGHT = 0.25
POSE_WEIGHTS = (2.0, 2.0, 2.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
MASK_FOCAL_WEIGHT = 10.0
MASK_DICE_WEIGHT = 1.0

Losses = dict[str, Tensor]  # scalars by name


def detection_losses(
    predictions: list[Prediction], boxes: Tensor, labels: Tensor, auxiliary_matches: int = 1
) -> Losses:
    """The losses of every decoder layer: `class_0`, `box_0`, ...

    predictions: one prediction per layer.
    boxes: (D, 9), the ground truth; an unknown velocity is NaN.
    labels: (D), the class indices of the ground truth.
    auxiliary_matches: queries per object in all layers but the last (hybrid matching, Jia et al., 2023). In the last
        layer every object has one query.
    """
    poses = encode_boxes(boxes)
    losses: Losses = {}
    for layer, prediction in enumerate(predictions):
        repeats = 1 if layer == len(predictions) - 1 else auxiliary_matches
        assignment = match_queries(prediction, poses, labels, repeats)
        losses[f"class_{layer}"] = CLASS_WEIGHT * class_loss(prediction.class_logits, labels, assignment)
        losses[f"box_{layer}"] = BOX_WEIGHT * box_loss(prediction.pose, poses, assignment)
    return losses


def class_loss(class_logits: Tensor, labels: Tensor, assignment: Assignment) -> Tensor:
    """The focal loss summed over all queries and classes, divided by the number of matched queries.

    class_logits: (Q, classes).
    labels: (D), the class indices of the ground truth.
    """
    targets = torch.zeros_like(class_logits)
    targets[assignment.queries, labels[assignment.objects]] = 1.0
    return focal_loss(class_logits, targets).sum() / max(1, len(assignment.queries))


def box_loss(pose: Tensor, true_poses: Tensor, assignment: Assignment) -> Tensor:
    """The weighted L1 distance of the matched pose vectors, divided by the number of matched queries.

    pose: (Q, 10), the predicted pose vectors.
    true_poses: (D, 10), the ground truth. Unknown values are NaN and add no loss.
    """
    expected = true_poses[assignment.objects]
    known = expected.isfinite()
    distance = (pose[assignment.queries] - expected.nan_to_num()).abs() * known * pose.new_tensor(POSE_WEIGHTS)
    return distance.sum() / max(1, len(assignment.queries))


def map_losses(maps: dict[str, Tensor], masks: Tensor, known: Tensor) -> Losses:
    """The losses of each map class: `focal_lane_boundary`, `dice_lane_boundary`, ...

    maps: logits (1, 1, X, Y) by map class.
    masks: (map classes, X, Y) bool, the ground truth in the order of `maps`.
    known: (map classes) bool. A map class without ground truth has no loss: 0, and no gradient.
    """
    losses: Losses = {}
    for (name, logits), mask, is_known in zip(maps.items(), masks, known, strict=True):
        targets, weight = mask.to(logits.dtype), is_known.to(logits.dtype)
        losses[f"focal_{name}"] = weight * MASK_FOCAL_WEIGHT * focal_loss(logits[0, 0], targets, alpha=0.5).mean()
        losses[f"dice_{name}"] = weight * MASK_DICE_WEIGHT * dice_loss(logits[0, 0], targets)
    return losses


def dice_loss(logits: Tensor, mask: Tensor) -> Tensor:
    """1 - (2 |P ∩ M| + 1) / (|P| + |M| + 1), with logits and mask (X, Y).

    The added ones make the loss of an empty prediction for an empty mask 0.
    """
    score = logits.sigmoid()
    return 1 - (2 * (score * mask).sum() + 1) / (score.sum() + mask.sum() + 1)
