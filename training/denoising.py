"""Denoising (DN-DETR, Li et al., 2022): queries that begin beside a true object are to find it.

Which query should find which object is uncertain while the matching is young; here it is given, and every layer learns
from the first step on how to get from about there to the object. Queries of this kind see each other but not the
model's own, which would learn from them where objects are.
"""

from torch import Generator, Tensor, rand

from ..model.decoder import Prediction
from ..model.geometry import encode_boxes
from .losses import BOX_WEIGHT, Losses, box_loss
from .matching import Match

# How far a pose vector begins from the truth, at most: x y z [m], log w l h, sin cos, vx vy [m/s].
NOISE = (3.0, 3.0, 0.5, 0.3, 0.3, 0.3, 0.8, 0.8, 3.0, 3.0)


def noised_queries(content: Tensor, boxes: Tensor, generator: Generator) -> tuple[Tensor, Tensor]:
    """Queries beside boxes (D, 9): content (D, content channels), pose (D, 10).

    Their content is that of some of the model's own queries, content (Q, content channels), drawn from D shares of
    them in turn, so that the queries of a space stay with it where each has its own (`UnsharedAttention`).
    """
    count = len(boxes)
    noise = (2 * rand((count, 10), generator=generator) - 1).to(boxes) * boxes.new_tensor(NOISE)
    share = rand(count, generator=generator).to(boxes)
    place = (boxes.new_tensor(range(count)) + share) / max(1, count) * len(content)
    return content[place.long().clamp(max=len(content) - 1)], encode_boxes(boxes).nan_to_num() + noise


def denoising_losses(predictions: list[Prediction], boxes: Tensor) -> Losses:
    """`denoised_0`, ...: how far each layer's pose is from the truth, boxes (D, 9); query i began beside box i."""
    places = boxes.new_tensor(range(len(boxes))).long()
    match, poses = Match(places, places), encode_boxes(boxes)
    return {
        f"denoised_{layer}": BOX_WEIGHT * box_loss(prediction.pose, poses, match)
        for layer, prediction in enumerate(predictions)
    }
