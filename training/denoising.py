"""Denoising queries (DN-DETR, Li et al., 2022): queries near ground-truth boxes, trained to find these boxes.

Early in a training, the matching of queries to objects is unstable. A denoising query has a known object, so every
decoder layer learns to refine a pose from the first step on. Denoising queries pass through the decoder apart from the
model's queries. Otherwise self-attention would tell the model's queries the positions of the objects.
"""

import torch
from torch import Generator, Tensor

from ..model.decoder import Prediction
from ..model.pose_vectors import encode_boxes
from .hungarian_matching import Assignment
from .losses import BOX_WEIGHT, Losses, box_loss

# Maximum noise on a pose vector: x y z [m], log w l h, sin cos, vx vy [m/s].
NOISE = (3.0, 3.0, 0.5, 0.3, 0.3, 0.3, 0.8, 0.8, 3.0, 3.0)


def shuffle_boxes(boxes: Tensor, generator: Generator, twice: bool) -> Tensor:
    """Boxes (D, 9) in random order, because the order of the ground truth carries information.

    twice: return all boxes twice, (2D, 9). With `UnsharedAttention` the first half of the queries attends to BEV and
    the second half to PV.
    """
    boxes = boxes[torch.randperm(len(boxes), generator=generator).to(boxes.device)]
    return boxes.repeat(2, 1) if twice else boxes


def denoising_queries(content: Tensor, boxes: Tensor, generator: Generator) -> tuple[Tensor, Tensor]:
    """One query near each box.

    content: (Q, content channels) of the model's queries.
    boxes: (D, 9).

    Returns the content (D, content channels) and the pose (D, 10) of the denoising queries. The content of query i is
    that of a model query, sampled from the i-th of D equal parts. With an even D, the first half of the denoising
    queries therefore uses content of the first half of the model's queries, as `UnsharedAttention` needs.
    """
    count = len(boxes)
    noise = 2 * torch.rand((count, 10), generator=generator) - 1
    fraction = (torch.arange(count) + torch.rand(count, generator=generator)) / max(1, count)
    index = (fraction * len(content)).long().clamp(max=len(content) - 1).to(content.device)
    # An unknown velocity (NaN) counts as 0 here; the loss ignores it.
    pose = encode_boxes(boxes).nan_to_num() + noise.to(boxes.device) * boxes.new_tensor(NOISE)
    return content[index], pose


def denoising_losses(predictions: list[Prediction], boxes: Tensor) -> Losses:
    """The box loss of each layer, `denoised_0`, ...

    predictions: of the denoising queries, per layer.
    boxes: (D, 9) ground truth; query i belongs to box i.
    """
    indices = torch.arange(len(boxes), device=boxes.device)
    assignment, poses = Assignment(indices, indices), encode_boxes(boxes)
    return {
        f"denoised_{layer}": BOX_WEIGHT * box_loss(prediction.pose, poses, assignment)
        for layer, prediction in enumerate(predictions)
    }
