"""Anchors: where the pose vectors of the queries stand before anything is learned."""

import torch
from torch import Tensor


@torch.no_grad()
def place_anchors(pose: Tensor, centres_m: Tensor) -> None:
    """Write centres (Q, 3) [m], in the ego frame, to x, y, z of pose vectors (..., Q, 10), in place.

    The poses' other numbers stay as they are. Raises ValueError unless there is one centre a query, and finite.
    """
    if centres_m.shape != (pose.shape[-2], 3):
        expected, got = (pose.shape[-2], 3), tuple(centres_m.shape)
        raise ValueError(f"anchors: expected one centre a query, {expected}; got {got}")
    if not bool(centres_m.isfinite().all()):
        raise ValueError("anchors: expected finite metres; got NaN or Inf")
    pose[..., :3] = centres_m.to(pose)
