"""Hungarian matching of queries to ground-truth objects, as in DETR (Carion et al., 2020)."""

from collections.abc import Collection, Sequence
from typing import NamedTuple

import torch
from scipy.optimize import linear_sum_assignment
from torch import Tensor

from ...model.decoder import Prediction
from ..settings import Settings
from .focal_loss import ALPHA, GAMMA

YAW = slice(6, 8)  # the sine and the cosine in a pose vector


class Assignment(NamedTuple):
    """Pairs of a query and an object: query `queries[i]` is trained to predict object `objects[i]`.

    queries: (M) indices of queries; no query occurs twice.
    objects: (M) indices of objects.
    """

    queries: Tensor
    objects: Tensor


class CostWeights(NamedTuple):
    """The weights of the matching costs.

    classes, boxes: the weights of the class cost and of the box cost.
    poses: (classes, 10), the weights of the numbers of a pose vector, by the class of the object.
    """

    classes: float
    boxes: float
    poses: Tensor


def cost_weights(settings: Settings, classes: Sequence[str]) -> CostWeights:
    """The weights of the settings for a model with these classes."""
    poses = weights_by_class(settings.match_box_weights, classes, settings.yaw_free_classes)
    return CostWeights(settings.match_class_cost, settings.match_box_cost, poses)


def weights_by_class(weights: Sequence[float], classes: Sequence[str], yaw_free_classes: Collection[str]) -> Tensor:
    """The weights (classes, 10) of pose vectors by class. The yaw of the classes `yaw_free_classes` has weight 0."""
    by_class = torch.tensor(weights).repeat(len(classes), 1)
    by_class[[name in yaw_free_classes for name in classes], YAW] = 0.0
    return by_class


@torch.no_grad()
def match_queries(
    prediction: Prediction, poses: Tensor, labels: Tensor, weights: CostWeights, repeats: int = 1
) -> Assignment:
    """Match queries with objects at the least total cost.

    prediction: the prediction of one decoder layer, for Q queries.
    poses: (D, 10) pose vectors of the objects; an unknown velocity is NaN.
    labels: (D) class indices of the objects.
    weights: the weights of the costs.
    repeats: queries per object. If there are too few queries, every object has the largest number that is possible for
        all objects.

    A query is matched to at most one object. With more objects than queries, every query has an object.
    """
    num_queries, num_objects = len(prediction.pose), len(poses)
    num_copies = max(1, min(repeats, num_queries // max(1, num_objects)))
    cost = matching_costs(prediction, poses, labels, weights).repeat(1, num_copies)
    # scipy refuses NaN and infinity. The trainer reports them when the loss is not finite.
    cost = torch.where(cost.isfinite(), cost, 0.0)
    queries, columns = linear_sum_assignment(cost.cpu().numpy())
    objects = columns % max(1, num_objects)
    device = prediction.pose.device
    return Assignment(torch.as_tensor(queries, device=device), torch.as_tensor(objects, device=device))


def matching_costs(prediction: Prediction, poses: Tensor, labels: Tensor, weights: CostWeights) -> Tensor:
    """The cost (Q, D) of each pair of a query and an object, float64.

    The class cost is the increase of the focal loss if the object's class becomes the target (Deformable-DETR).
    The box cost is the weighted L1 distance of the pose vectors, with weight 0 for an unknown velocity.
    """
    score = prediction.class_logits.double().sigmoid()
    positive = -ALPHA * (1 - score) ** GAMMA * (score + 1e-12).log()
    negative = -(1 - ALPHA) * score**GAMMA * (1 - score + 1e-12).log()
    difference = (prediction.pose.double()[:, None] - poses.double().nan_to_num()).abs()
    pose_weights = weights.poses.to(difference)[labels] * poses.isfinite()
    return weights.classes * (positive - negative)[:, labels] + weights.boxes * (difference * pose_weights).sum(dim=-1)
