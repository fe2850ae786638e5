"""Denoising (DN-DETR, Li et al., 2022): queries that begin beside a true object are to find it.

Which query should find which object is uncertain while the matching is young; here it is given, and every layer learns
from the first step on how to get from about there to the object. Queries of this kind see each other but not the
model's own, which would learn from them where objects are.
"""

import torch
from torch import Generator, Tensor

from ..model.decoder import Prediction
from ..model.pose_vectors import encode_boxes
from .hungarian_matching import Assignment
from .losses import BOX_WEIGHT, Losses, box_loss

# How far a pose vector begins from the truth, at most: x y z [m], log w l h, sin cos, vx vy [m/s].
NOISE = (3.0, 3.0, 0.5, 0.3, 0.3, 0.3, 0.8, 0.8, 3.0, 3.0)


def shuffled(boxes: Tensor, generator: Generator, unshared: bool) -> Tensor:
    """Boxes (D, 9) in another order, for that of the truth says something. unshared: all twice, for queries whose first
    half looks into BEV and whose second half into PV (`UnsharedAttention`).
    """
    boxes = boxes[torch.randperm(len(boxes), generator=generator).to(boxes.device)]
    return boxes.repeat(2, 1) if unshared else boxes


def noised_queries(content: Tensor, boxes: Tensor, generator: Generator) -> tuple[Tensor, Tensor]:
    """Queries beside boxes (D, 9): content (D, content channels), pose (D, 10).

    Their content is that of some of the model's own queries, content (Q, content channels): query i has that of one
    drawn from the i-th of D equal shares, so that of an even number each half keeps to its half.
    """
    count = len(boxes)
    noise = 2 * torch.rand((count, 10), generator=generator) - 1
    share = (torch.arange(count) + torch.rand(count, generator=generator)) / max(1, count)
    place = (share * len(content)).long().clamp(max=len(content) - 1).to(content.device)
    pose = encode_boxes(boxes).nan_to_num() + noise.to(boxes.device) * boxes.new_tensor(NOISE)
    return content[place], pose


def denoising_losses(predictions: list[Prediction], boxes: Tensor) -> Losses:
    """`denoised_0`, ...: how far each layer's pose is from the truth, boxes (D, 9); query i began beside box i."""
    places = torch.arange(len(boxes), device=boxes.device)
    match, poses = Assignment(places, places), encode_boxes(boxes)
    return {
        f"denoised_{layer}": BOX_WEIGHT * box_loss(prediction.pose, poses, match)
        for layer, prediction in enumerate(predictions)
    }
