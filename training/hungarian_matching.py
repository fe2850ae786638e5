"""Which query is to find which object: the bipartite matching of DETR (Carion et al., 2020), by Hungarian method."""

from typing import NamedTuple

import torch
from scipy.optimize import linear_sum_assignment
from torch import Tensor

from ..model.decoder import Prediction
from .focal_loss import ALPHA, GAMMA

CLASS_COST = 2.0  # Sparse4D's, as the paper follows it
BOX_COST = 0.25
POSE_COST_WEIGHTS = (2.0, 2.0, 2.0, 0.5, 0.5, 0.5, 0.0, 0.0, 0.0, 0.0)


class Match(NamedTuple):
    """queries (M) and objects (M): query `queries[i]` is to predict object `objects[i]`."""

    queries: Tensor
    objects: Tensor


@torch.no_grad()
def match_queries(prediction: Prediction, poses: Tensor, labels: Tensor, repeats: int = 1) -> Match:
    """Match queries with true objects so that the sum of costs is least.

    poses (D, 10): the objects' pose vectors; labels (D). Every object gets `repeats` queries, as long as there are
    enough for all; each query has at most one object. Where there are more objects than queries, the cheapest pairs.
    """
    num_queries, num_objects = len(prediction.pose), len(poses)
    times = max(1, min(repeats, num_queries // max(1, num_objects)))
    cost = costs(prediction, poses, labels).repeat(1, times)
    cost = torch.where(cost.isfinite(), cost, 0.0)  # scipy takes no other; the loss tells that something is wrong
    queries, columns = linear_sum_assignment(cost.cpu().numpy())
    device = prediction.pose.device
    return Match(torch.as_tensor(queries, device=device), torch.as_tensor(columns % max(1, num_objects), device=device))


def costs(prediction: Prediction, poses: Tensor, labels: Tensor) -> Tensor:
    """(Q, D): what it would cost each query to have each object.

    Of the class, what the focal loss would rise by if the object's class became the truth (Deformable-DETR); of the
    pose, the weighted L1 distance.
    """
    score = prediction.class_logits.double().sigmoid()
    positive = -ALPHA * (1 - score) ** GAMMA * (score + 1e-12).log()
    negative = -(1 - ALPHA) * score**GAMMA * (1 - score + 1e-12).log()
    weights = prediction.pose.new_tensor(POSE_COST_WEIGHTS).double()
    distance = torch.cdist(prediction.pose.double() * weights, poses.double().nan_to_num() * weights, p=1)
    return CLASS_COST * (positive - negative)[:, labels] + BOX_COST * distance
