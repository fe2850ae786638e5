"""Projection of points into the cameras, and the cell centres of the voxel grid."""

from collections.abc import Sequence

import torch
from torch import Tensor

from .config import VoxelGrid

OUTSIDE = -1.0  # location of an invisible point: so far outside the image that samples of every level are zero
NEAREST_DEPTH_M = 0.1  # a point with a smaller depth is not visible


def axis_centres(voxels: VoxelGrid) -> list[Tensor]:
    """The cell centres along x (X), y (Y) and z (Z) [m] in the ego frame; float64."""
    return [
        lower + (torch.arange(count, dtype=torch.float64) + 0.5) * (upper - lower) / count
        for count, lower, upper in zip(voxels.size, voxels.lower_m, voxels.upper_m, strict=True)
    ]


def project(points: Tensor, image_T_ego: Tensor, width_px: int, height_px: int) -> tuple[Tensor, Tensor]:
    """Project points into every camera.

    points (..., Q, 3) [m]: in the ego frame.
    image_T_ego (..., N, 3, 4) [px]: from the ego frame to pixels of the images.
    width_px, height_px: the size of the images.

    Returns locations (..., N, 2, Q) and `visible` (..., N, Q) bool.
    A location is (u / width, v / height), a fraction of the image. It is therefore the same on all feature levels.
    A point is visible if its depth is above NEAREST_DEPTH_M and it is inside the image. The locations of other points
    are OUTSIDE.
    """
    # In float32, PyTorch and onnxruntime could put a point near an image border on different sides, because they add in
    # different orders.
    points, image_T_ego = points.double(), image_T_ego.double()
    homogeneous = image_T_ego[..., :3] @ points.mT[..., None, :, :] + image_T_ego[..., 3:]
    return _locations(homogeneous, width_px, height_px)


def project_grid(axes: Sequence[Tensor], image_T_ego: Tensor, width_px: int, height_px: int) -> tuple[Tensor, Tensor]:
    """Project the cell centres of a voxel grid into every camera, as `project` does.

    axes: the cell centres along x (X), y (Y) and z (Z) [m] in the ego frame; float64.
    image_T_ego (N, 3, 4) [px].

    Returns locations (N, 2, Z·X·Y) and `visible` (N, Z·X·Y) bool; z varies slowest and y fastest.
    """
    # The projection of a grid is a sum of one term per axis. Sums of broadcast terms take a twentieth of the time of
    # the matrix product.
    along_x, along_y, along_z = (
        column[..., None] * axis for column, axis in zip(image_T_ego[..., :3].double().unbind(-1), axes, strict=True)
    )
    along_z = along_z + image_T_ego[..., 3:].double()
    homogeneous = (along_z[..., :, None] + along_x[..., None, :])[..., None] + along_y[..., None, None, :]
    return _locations(homogeneous.flatten(2), width_px, height_px)


def _locations(homogeneous: Tensor, width_px: int, height_px: int) -> tuple[Tensor, Tensor]:
    """Divide homogeneous pixels (..., 3, Q) by their depth [m]; returns the results of `project`."""
    depth_m = homogeneous[..., 2:, :]
    size_px = torch.tensor([[width_px], [height_px]], dtype=torch.float64, device=homogeneous.device)
    # The clamp avoids a division by 0. It changes no visible point.
    locations = homogeneous[..., :2, :] / (depth_m.clamp(min=NEAREST_DEPTH_M) * size_px)
    inside = (locations >= 0) & (locations < 1)
    visible = (depth_m[..., 0, :] > NEAREST_DEPTH_M) & inside[..., 0, :] & inside[..., 1, :]
    return torch.where(visible[..., None, :], locations, OUTSIDE).float(), visible
