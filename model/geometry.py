"""Projection into the cameras, and the motion of poses through time."""

import torch
from torch import Tensor

from .config import VoxelGrid

OUTSIDE = -1.0  # a location (fraction of an image) at which even the smallest level samples its zero padding
NEAREST_DEPTH_M = 0.1  # what lies nearer to a camera's plane, or behind it, is not seen


def axis_centres(voxels: VoxelGrid) -> list[Tensor]:
    """The centres of the cells along x (X), y (Y) and z (Z) [m] in the ego frame; float64."""
    return [
        lower + (torch.arange(count, dtype=torch.float64) + 0.5) * (upper - lower) / count
        for count, lower, upper in zip(voxels.size, voxels.lower_m, voxels.upper_m, strict=True)
    ]


def project(points: Tensor, image_T_ego: Tensor, width_px: int, height_px: int) -> tuple[Tensor, Tensor]:
    """Project points of the ego frame into every camera.

    points (..., Q, 3) [m]; image_T_ego (..., N, 3, 4) [px].
    Returns locations (..., N, Q, 2) as fractions (u / width, v / height) of the image, and `seen` (..., N, Q): in front
    of the camera by more than NEAREST_DEPTH_M, and inside the image. Locations of points not seen are OUTSIDE.

    The arithmetic is float64: which side of an image border a point lies on must not hang on the order in
    which an engine adds.
    """
    points, image_T_ego = points.double(), image_T_ego.double()
    homogeneous = points[..., None, :, :] @ image_T_ego[..., :3].mT + image_T_ego[..., None, :, 3]
    depth_m = homogeneous[..., 2]
    size_px = torch.tensor([width_px, height_px], dtype=torch.float64, device=points.device)
    locations = homogeneous[..., :2] / depth_m.clamp(min=NEAREST_DEPTH_M)[..., None] / size_px
    inside = (locations >= 0) & (locations < 1)
    seen = (depth_m > NEAREST_DEPTH_M) & inside[..., 0] & inside[..., 1]
    return torch.where(seen[..., None], locations, OUTSIDE).float(), seen


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
