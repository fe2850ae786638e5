"""The matching costs and the detection losses of Sparse4D v1, as loops over queries, objects and numbers.

The class cost and the focal loss are those of Deformable-DETR.
"""

import math

import numpy as np
from scipy.optimize import linear_sum_assignment

ALPHA, GAMMA = 0.25, 2
YAW = (6, 7)


def sparse4d_costs(prediction, poses, labels, settings, cone):
    """The cost of each query and object. poses: pose vectors; cone: the class whose yaw has no weight in the paper."""
    logits, pose = prediction.class_logits.double().tolist(), prediction.pose.double().tolist()
    cone = cone if settings.yaw_free_classes else None
    return [
        [
            settings.match_class_cost * _class_cost(_sigmoid(logits[query][label]))
            + settings.match_box_cost * _distance(pose[query], true, settings.match_box_weights, label == cone)
            for true, label in zip(poses.double().tolist(), labels.tolist(), strict=True)
        ]
        for query in range(len(pose))
    ]


def sparse4d_losses(frames, settings, cone):
    """The class loss and the box loss of one decoder layer on a batch of frames, one frame per GPU.

    frames: a prediction, boxes and labels each.
    Returns the mean of the losses of the GPUs, as DistributedDataParallel averages the gradients.
    """
    class_sums, box_sums, num_matched = [], [], []
    for prediction, boxes, labels in frames:
        poses = _encode(boxes.double().numpy())
        pairs = []
        if len(boxes):
            costs = np.array(sparse4d_costs(prediction, _Rows(poses), labels, settings, cone))
            pairs = list(zip(*linear_sum_assignment(costs), strict=True))
        num_matched.append(len(pairs))
        class_sums.append(_class_sum(prediction.class_logits.double().tolist(), labels.tolist(), pairs))
        box_sums.append(_box_sum(prediction, poses, labels.tolist(), pairs, settings, cone))
    divisor = max(1.0, sum(num_matched) / len(frames))  # reduce_mean over the GPUs
    class_loss = settings.class_weight * sum(class_sums) / divisor / len(frames)
    return class_loss, settings.box_weight * sum(box_sums) / divisor / len(frames)


class _Rows(list):
    """A list with the methods of a tensor that `sparse4d_costs` uses."""

    def double(self):
        return self

    def tolist(self):
        return self


def _encode(boxes):
    """Pose vectors x y z, log w l h, sin cos, vx vy of boxes x y z w l h yaw vx vy."""
    return [
        [*box[:3], *(math.log(size) for size in box[3:6]), math.sin(box[6]), math.cos(box[6]), *box[7:]]
        for box in boxes.tolist()
    ]


def _class_sum(logits, labels, pairs):
    """The focal loss over all queries and classes. A query without an object has the target 0 for every class."""
    target_of = {query: labels[target] for query, target in pairs}
    total = 0.0
    for query, row in enumerate(logits):
        for label, logit in enumerate(row):
            score = _sigmoid(logit)
            if target_of.get(query) == label:
                total += -ALPHA * (1 - score) ** GAMMA * math.log(score)
            else:
                total += -(1 - ALPHA) * score**GAMMA * math.log(1 - score)
    return total


def _box_sum(prediction, poses, labels, pairs, settings, cone):
    """The L1 distances of matched queries whose largest class score is above the threshold."""
    cone = cone if settings.yaw_free_classes else None
    total = 0.0
    for query, target in pairs:
        best = max(_sigmoid(logit) for logit in prediction.class_logits[query].double().tolist())
        if settings.box_loss_min_score > 0 and best <= settings.box_loss_min_score:
            continue
        predicted = prediction.pose[query].double().tolist()
        total += _distance(predicted, poses[target], settings.box_loss_weights, labels[target] == cone)
    return total


def _distance(predicted, true, weights, without_yaw):
    """The weighted L1 distance. An unknown velocity, which is NaN, has no weight."""
    return sum(
        weight * abs(a - b)
        for k, (a, b, weight) in enumerate(zip(predicted, true, weights, strict=True))
        if not math.isnan(b) and not (without_yaw and k in YAW)
    )


def _class_cost(score):
    eps = 1e-12
    positive = -math.log(score + eps) * ALPHA * (1 - score) ** GAMMA
    negative = -math.log(1 - score + eps) * (1 - ALPHA) * score**GAMMA
    return positive - negative


def _sigmoid(logit):
    return 1 / (1 + math.exp(-logit))
