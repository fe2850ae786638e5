"""Pose vectors 𝒫: motion compensation to past frames, and conversion to and from boxes."""

import torch
from torch import Tensor


def compensate_motion(pose: Tensor, past_T_now: Tensor, time_delta_s: Tensor) -> Tensor:
    """Move objects of constant velocity back in time, into the ego frames of past frames (supplement, eqs. 1-4).

    pose (Q, 10): pose vectors in the current ego frame.
    past_T_now (T, 4, 4): from the current ego frame to the ego frame of each frame [m].
    time_delta_s (T): age of each frame [s].

    Returns pose vectors (T, Q, 10) in the ego frame of each frame. The paper's recursion from frame to frame is
    applied in closed form: the steps compose to one rigid transform, and the times add up.
    """
    # In float32, PyTorch and onnxruntime could project a point near an image border to different sides of it.
    past_T_now, time_delta_s = past_T_now.double(), time_delta_s.double()
    rotation, translation = past_T_now[:, :3, :3].mT, past_T_now[:, None, :3, 3]
    position, size, sin, cos, velocity = pose.double().split((3, 3, 1, 1, 2), dim=-1)
    zero = torch.zeros_like(sin)
    # Velocity and heading are rotated in 3D with z = 0, and their new z is dropped. For motion in a plane this equals
    # the paper's 2D form.
    velocity = torch.cat((velocity, zero), dim=-1)
    heading = torch.cat((cos, sin, zero), dim=-1)

    past_position = (position - time_delta_s[:, None, None] * velocity) @ rotation + translation
    past_cos, past_sin = (heading @ rotation)[..., :2].split(1, dim=-1)
    past_velocity = (velocity @ rotation)[..., :2]
    past_size = size.expand(past_T_now.shape[0], -1, -1)
    return torch.cat((past_position, past_size, past_sin, past_cos, past_velocity), dim=-1).float()


def decode_boxes(pose: Tensor) -> Tensor:
    """Convert pose vectors to boxes.

    pose (..., 10): x y z [m], log w, log l, log h of a size in metres, sin θ, cos θ, vx vy [m/s].

    Returns boxes (..., 9): x y z w l h [m], yaw [rad], vx vy [m/s]. (sin θ, cos θ) need not have length 1.
    """
    position, log_size, sin, cos, velocity = pose.split((3, 3, 1, 1, 2), dim=-1)
    return torch.cat((position, log_size.exp(), torch.atan2(sin, cos), velocity), dim=-1)


def encode_boxes(boxes: Tensor) -> Tensor:
    """Convert boxes (..., 9) to pose vectors (..., 10). This is the inverse of `decode_boxes`.

    Width, length and height must be positive. (sin θ, cos θ) has length 1. A NaN velocity stays NaN.
    """
    position, size, yaw, velocity = boxes.split((3, 3, 1, 2), dim=-1)
    return torch.cat((position, size.log(), yaw.sin(), yaw.cos(), velocity), dim=-1)
