"""Detection and map losses of one frame (paper, supplement, "Training Details").

Detection: at every decoder layer, the focal loss on the classes and L1 on the pose vectors of matched queries.
Map: the focal loss and the dice loss (Sudre et al., 2017) of each predicted mask.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from ...model.decoder import Prediction
from ...model.pose_vectors import encode_boxes
from ..settings import Settings
from .focal_loss import focal_loss
from .hungarian_matching import Assignment, cost_weights, match_queries, weights_by_class

# The weights of Sparse4D, for the supervision heads. The decoder's are settings.
BOX_WEIGHT = 0.25
POSE_WEIGHTS = (2.0, 2.0, 2.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0)

Losses = dict[str, Tensor]  # scalars by name


def detection_losses(
    predictions: list[Prediction], boxes: Tensor, labels: Tensor, settings: Settings, classes: Sequence[str]
) -> Losses:
    """The losses of every decoder layer: `class_0`, `box_0`, ..., each divided by the number of matched queries.

    predictions: one prediction per layer.
    boxes: (D, 9), the ground truth; an unknown velocity is NaN.
    labels: (D), the class indices of the ground truth.
    settings: the weights, and `auxiliary_matches`, the queries per object in all layers but the last (hybrid matching,
        Jia et al., 2023). In the last layer every object has one query.
    classes: the names of the classes.
    """
    poses = encode_boxes(boxes)
    costs = cost_weights(settings, classes)
    pose_weights = weights_by_class(settings.box_loss_weights, classes, settings.yaw_free_classes).to(poses)
    losses: Losses = {}
    for layer, prediction in enumerate(predictions):
        repeats = 1 if layer == len(predictions) - 1 else settings.auxiliary_matches
        assignment = match_queries(prediction, poses, labels, costs, repeats)
        weights = pose_weights[labels[assignment.objects]]
        if settings.box_loss_min_score > 0:
            # As in Sparse4D, the number that the loss is divided by counts all matched queries.
            scores = prediction.class_logits.sigmoid().amax(dim=-1)[assignment.queries]
            weights = weights * (scores > settings.box_loss_min_score)[:, None]
        losses[f"class_{layer}"] = settings.class_weight * class_loss(prediction.class_logits, labels, assignment)
        losses[f"box_{layer}"] = settings.box_weight * box_loss(prediction.pose, poses, assignment, weights)
    return losses


def frame_weight(num_objects: int, objects_per_frame: float) -> float:
    """The weight of the detection losses of a frame, if the mean over a batch of frames is Sparse4D's loss.

    Sparse4D divides the losses of all frames by the same number: the mean number of matched queries per frame, at
    least 1. `detection_losses` divides those of each frame by the frame's own number.

    num_objects: the matched queries of the frame.
    objects_per_frame: their mean over all frames of the batch.
    """
    return max(1, num_objects) / max(1.0, objects_per_frame)


def class_loss(class_logits: Tensor, labels: Tensor, assignment: Assignment) -> Tensor:
    """The focal loss summed over all queries and classes, divided by the number of matched queries.

    class_logits: (Q, classes).
    labels: (D), the class indices of the ground truth.
    """
    targets = torch.zeros_like(class_logits)
    targets[assignment.queries, labels[assignment.objects]] = 1.0
    return focal_loss(class_logits, targets).sum() / max(1, len(assignment.queries))


def box_loss(pose: Tensor, true_poses: Tensor, assignment: Assignment, weights: Tensor | None = None) -> Tensor:
    """The weighted L1 distance of the matched pose vectors, divided by the number of matched queries.

    pose: (Q, 10), the predicted pose vectors.
    true_poses: (D, 10), the ground truth. Unknown values are NaN and add no loss.
    weights: (10), or (M, 10) for the M pairs of the assignment; by default `POSE_WEIGHTS`.
    """
    expected = true_poses[assignment.objects]
    known = expected.isfinite()
    weights = pose.new_tensor(POSE_WEIGHTS) if weights is None else weights
    distance = (pose[assignment.queries] - expected.nan_to_num()).abs() * known * weights
    return distance.sum() / max(1, len(assignment.queries))


def map_losses(maps: dict[str, Tensor], masks: Tensor, known: Tensor, settings: Settings) -> Losses:
    """The losses of each map class: `focal_lane_boundary`, `dice_lane_boundary`, ...

    maps: logits (1, 1, X, Y) by map class.
    masks: (map classes, X, Y) bool, the ground truth in the order of `maps`.
    known: (map classes) bool. A map class without ground truth has no loss: 0, and no gradient.
    settings: the weights.
    """
    losses: Losses = {}
    for (name, logits), mask, is_known in zip(maps.items(), masks, known, strict=True):
        targets, weight = mask.to(logits.dtype), is_known.to(logits.dtype)
        focal = focal_loss(logits[0, 0], targets, alpha=0.5).mean()
        losses[f"focal_{name}"] = weight * settings.map_focal_weight * focal
        losses[f"dice_{name}"] = weight * settings.map_dice_weight * dice_loss(logits[0, 0], targets)
    return losses


def dice_loss(logits: Tensor, mask: Tensor) -> Tensor:
    """1 - (2 |P ∩ M| + 1) / (|P| + |M| + 1), with logits and mask (X, Y).

    The added ones make the loss of an empty prediction for an empty mask 0.
    """
    score = logits.sigmoid()
    return 1 - (2 * (score * mask).sum() + 1) / (score.sum() + mask.sum() + 1)
