"""Denoising queries (DN-DETR, Li et al., 2022): queries near ground-truth boxes, trained to find these boxes.

Early in training, the matching of queries to objects is unstable. A denoising query has a known object, so every
decoder layer learns to refine a pose from the first step on. Denoising queries and the model's queries pass through the
decoder separately. Otherwise, self-attention would pass the positions of the objects to the model's queries.
"""

import torch
from torch import Generator, Tensor

from ...model.decoder import Prediction
from ...model.pose_vectors import encode_boxes
from ..settings import Settings
from .frame_losses import Losses, box_loss
from .hungarian_matching import Assignment

# Maximum noise on a pose vector: x y z [m], log w l h, sin cos, vx vy [m/s].
NOISE = (3.0, 3.0, 0.5, 0.3, 0.3, 0.3, 0.8, 0.8, 3.0, 3.0)


def shuffle_boxes(boxes: Tensor, generator: Generator, twice: bool) -> Tensor:
    """Return boxes (D, 9) in random order, because the order of the ground truth carries information.

    twice: return all boxes twice, (2D, 9). `UnsharedAttention` needs this: there the first half of the queries attends
        to BEV and the second half to PV.
    """
    boxes = boxes[torch.randperm(len(boxes), generator=generator).to(boxes.device)]
    return boxes.repeat(2, 1) if twice else boxes


def denoising_queries(content: Tensor, boxes: Tensor, generator: Generator) -> tuple[Tensor, Tensor]:
    """Make one query near each box.

    content: (Q, content channels), the content of the model's queries.
    boxes: (D, 9), the ground truth.
    generator: the source of the noise (CPU).

    Returns the content (D, content channels) and the pose vectors (D, 10) of the denoising queries. The model's queries
    are divided into D equal parts; query i has the content of a query sampled from part i. If D is even, the first half
    of the denoising queries therefore has content of the first half of the model's queries, as `UnsharedAttention`
    needs.
    """
    count = len(boxes)
    noise = 2 * torch.rand((count, 10), generator=generator) - 1
    fraction = (torch.arange(count) + torch.rand(count, generator=generator)) / max(1, count)
    index = (fraction * len(content)).long().clamp(max=len(content) - 1).to(content.device)
    # An unknown velocity (NaN) counts as 0 here; the loss ignores it.
    pose = encode_boxes(boxes).nan_to_num() + noise.to(boxes.device) * boxes.new_tensor(NOISE)
    return content[index], pose


def denoising_losses(predictions: list[Prediction], boxes: Tensor, settings: Settings) -> Losses:
    """The box loss of each layer, `denoised_0`, ...

    predictions: the predictions for the denoising queries, one per layer.
    boxes: (D, 9), the ground truth; query i belongs to box i.
    settings: the weights. All matched queries have a loss, and all yaws: `box_loss_min_score` and `yaw_free_classes`
        are for the model's queries.
    """
    indices = torch.arange(len(boxes), device=boxes.device)
    assignment, poses = Assignment(indices, indices), encode_boxes(boxes)
    weights = poses.new_tensor(settings.box_loss_weights)
    return {
        f"denoised_{layer}": settings.box_weight * box_loss(prediction.pose, poses, assignment, weights)
        for layer, prediction in enumerate(predictions)
    }
