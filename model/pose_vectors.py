"""Pose vectors 𝒫: motion compensation to past frames, and conversion to and from boxes."""

import torch
from torch import Tensor


def compensate_motion(pose: Tensor, past_T_now: Tensor, time_delta_s: Tensor) -> Tensor:
    """Where an object of constant velocity was, seen from the ego frame of each earlier moment.

    pose (Q, 10): pose vectors in the current ego frame; past_T_now (T, 4, 4); time_delta_s (T): how long ago.
    Returns (T, Q, 10). Supplement, eqs. 1-4, in closed form: the steps from frame to frame compose to one
    rigid transform, and the times add up. The arithmetic is float64, as in `project` and for its reason.
    """
    past_T_now, time_delta_s = past_T_now.double(), time_delta_s.double()
    rotation, translation = past_T_now[:, :3, :3].mT, past_T_now[:, None, :3, 3]
    position, size, sin, cos, velocity = pose.double().split((3, 3, 1, 1, 2), dim=-1)
    still = torch.zeros_like(sin)
    velocity = torch.cat((velocity, still), dim=-1)
    heading = torch.cat((cos, sin, still), dim=-1)

    past_position = (position - time_delta_s[:, None, None] * velocity) @ rotation + translation
    past_cos, past_sin = (heading @ rotation)[..., :2].split(1, dim=-1)
    past_velocity = (velocity @ rotation)[..., :2]
    past_size = size.expand(past_T_now.shape[0], -1, -1)
    return torch.cat((past_position, past_size, past_sin, past_cos, past_velocity), dim=-1).float()


def decode_boxes(pose: Tensor) -> Tensor:
    """Pose vectors (..., 10), x y z, log w l h, sin θ, cos θ, vx vy, to boxes (..., 9): x y z w l h yaw vx vy."""
    position, log_size, sin, cos, velocity = pose.split((3, 3, 1, 1, 2), dim=-1)
    return torch.cat((position, log_size.exp(), torch.atan2(sin, cos), velocity), dim=-1)


def encode_boxes(boxes: Tensor) -> Tensor:
    """The inverse of `decode_boxes`, on the unit circle of (sin θ, cos θ)."""
    position, size, yaw, velocity = boxes.split((3, 3, 1, 2), dim=-1)
    return torch.cat((position, size.log(), yaw.sin(), yaw.cos(), velocity), dim=-1)
