"""Hungarian matching of queries to ground-truth objects, as in DETR (Carion et al., 2020)."""

from typing import NamedTuple

import torch
from scipy.optimize import linear_sum_assignment
from torch import Tensor

from ..model.decoder import Prediction
from .focal_loss import ALPHA, GAMMA

# The weights of Sparse4D, which the paper follows.
CLASS_COST = 2.0
BOX_COST = 0.25
POSE_COST_WEIGHTS = (2.0, 2.0, 2.0, 0.5, 0.5, 0.5, 0.0, 0.0, 0.0, 0.0)


class Assignment(NamedTuple):
    """Pairs of a query and an object: query `queries[i]` is trained to predict object `objects[i]`.

    queries: (M) indices of queries; no query occurs twice.
    objects: (M) indices of objects.
    """

    queries: Tensor
    objects: Tensor


@torch.no_grad()
def match_queries(prediction: Prediction, poses: Tensor, labels: Tensor, repeats: int = 1) -> Assignment:
    """Match queries with objects at the least total cost.

    prediction: the prediction of one decoder layer, for Q queries.
    poses: (D, 10) pose vectors of the objects; an unknown velocity is NaN.
    labels: (D) class indices of the objects.
    repeats: queries per object. If there are too few queries, every object has the largest number that is possible for
        all objects.

    A query is matched to at most one object. With more objects than queries, every query has an object.
    """
    num_queries, num_objects = len(prediction.pose), len(poses)
    num_copies = max(1, min(repeats, num_queries // max(1, num_objects)))
    cost = matching_costs(prediction, poses, labels).repeat(1, num_copies)
    # scipy refuses NaN and infinity. The trainer reports them when the loss is not finite.
    cost = torch.where(cost.isfinite(), cost, 0.0)
    queries, columns = linear_sum_assignment(cost.cpu().numpy())
    objects = columns % max(1, num_objects)
    device = prediction.pose.device
    return Assignment(torch.as_tensor(queries, device=device), torch.as_tensor(objects, device=device))


def matching_costs(prediction: Prediction, poses: Tensor, labels: Tensor) -> Tensor:
    """The cost (Q, D) of each pair of a query and an object, float64.

    The class cost is the increase of the focal loss if the object's class becomes the target (Deformable-DETR).
    The box cost is the weighted L1 distance of the pose vectors.
    """
    score = prediction.class_logits.double().sigmoid()
    positive = -ALPHA * (1 - score) ** GAMMA * (score + 1e-12).log()
    negative = -(1 - ALPHA) * score**GAMMA * (1 - score + 1e-12).log()
    weights = prediction.pose.new_tensor(POSE_COST_WEIGHTS).double()
    distance = torch.cdist(prediction.pose.double() * weights, poses.double().nan_to_num() * weights, p=1)
    return CLASS_COST * (positive - negative)[:, labels] + BOX_COST * distance
