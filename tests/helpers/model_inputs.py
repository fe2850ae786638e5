"""Inputs for tests of the model: an asymmetric configuration, cameras, motions, random weights, images and windows."""

import copy
from dataclasses import replace
from typing import TypeVar

import numpy as np
import torch
from torch import Tensor, nn

from duospacenet.model import PRESETS, DuoSpaceNetConfig
from duospacenet.model.config import VoxelGrid
from duospacenet.model.window import Window

Module = TypeVar("Module", bound=nn.Module)

# The three axes differ in the number of voxels, the range and the voxel size (5 m, 6.25 m, 2 m), so that swapped axes
# are detected.
ASYMMETRIC: DuoSpaceNetConfig = replace(
    PRESETS["tiny"],
    voxels=VoxelGrid((12, 8, 4), lower_m=(-20.0, -35.0, -3.0), upper_m=(40.0, 15.0, 5.0)),
    num_queries=10,
)


def assert_close(actual: Tensor, expected: np.ndarray | Tensor, relative: float = 1e-5) -> None:
    """Assert that the largest error is at most `relative` times the RMS of the expected values."""
    actual, expected = actual.detach().double().numpy(), np.asarray(expected, dtype=np.float64)
    assert actual.shape == expected.shape
    assert np.isfinite(actual).all()
    scale = np.sqrt((expected**2).mean())
    assert scale > 0, "the expected values are all zero: nothing is tested"
    error = np.abs(actual - expected).max() / scale
    assert error <= relative, f"relative error {error:.2e}"


def with_random_weights(module: Module, seed: int = 0, std: float = 0.3) -> Module:
    """A copy of `module` in evaluation mode, with random parameters and running statistics."""
    module = copy.deepcopy(module).eval()
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for name, tensor in module.state_dict().items():
            if name.endswith("running_var"):
                tensor.uniform_(0.5, 1.5, generator=generator)
            elif tensor.is_floating_point():
                tensor.normal_(0.0, std, generator=generator)
    return module


def normal(*shape: int, seed: int) -> Tensor:
    """Numbers of the standard normal distribution."""
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def rigid(yaw: float, pitch: float = 0.0, roll: float = 0.0, translation=(0.0, 0.0, 0.0)) -> np.ndarray:
    """A 4×4 rigid transform: roll, then pitch, then yaw [rad], then translation [m]."""
    (cy, sy), (cp, sp), (cr, sr) = ((np.cos(angle), np.sin(angle)) for angle in (yaw, pitch, roll))
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    matrix = np.eye(4)
    matrix[:3, :3] = about_z @ about_y @ about_x
    matrix[:3, 3] = translation
    return matrix


# A camera that looks forward has its x axis (right) along -y, its y axis (down) along -z and its z axis along x.
CAMERA_T_FORWARD = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])


def pinhole(focal_px: float, centre_px: tuple[float, float], ego_T_forward: np.ndarray) -> np.ndarray:
    """image_T_ego (3, 4) of a camera with the pose `ego_T_forward`, which looks along the x axis of that frame."""
    intrinsics = np.array([[focal_px, 0, centre_px[0]], [0, focal_px, centre_px[1]], [0, 0, 1.0]])
    return intrinsics @ (CAMERA_T_FORWARD @ np.linalg.inv(ego_T_forward))[:3]


def ring_of_cameras(num_cameras: int, width_px: int, height_px: int, seed: int = 0) -> Tensor:
    """image_T_ego (N, 3, 4) of cameras that look outward in all directions. All are tilted; neighbours overlap."""
    rng = np.random.default_rng(seed)
    matrices = []
    for index in range(num_cameras):
        yaw = 2 * np.pi * index / num_cameras + rng.uniform(-0.1, 0.1)
        position = (np.cos(yaw), 0.6 * np.sin(yaw), rng.uniform(1.4, 1.8))
        ego_T_forward = rigid(yaw, rng.uniform(-0.05, 0.1), rng.uniform(-0.05, 0.05), position)
        focal_px = width_px * rng.uniform(0.55, 0.65)
        matrices.append(pinhole(focal_px, (width_px * 0.48, height_px * 0.53), ego_T_forward))
    return torch.tensor(np.stack(matrices), dtype=torch.float32)


def random_poses(config: DuoSpaceNetConfig, num_queries: int, seed: int = 0) -> Tensor:
    """Pose vectors (Q, 10) inside and slightly outside the range, with random sizes, headings and velocities."""
    rng = np.random.default_rng(seed)
    lower_m, upper_m = np.array(config.voxels.lower_m), np.array(config.voxels.upper_m)
    position = lower_m + rng.uniform(-0.1, 1.1, (num_queries, 3)) * (upper_m - lower_m)
    yaw = rng.uniform(-np.pi, np.pi, (num_queries, 1))
    rest = rng.normal(0, 1, (num_queries, 3)), np.sin(yaw), np.cos(yaw), rng.normal(0, 5, (num_queries, 2))
    return torch.tensor(np.concatenate((position, *rest), axis=-1), dtype=torch.float32)


def random_window(config: DuoSpaceNetConfig, num_frames: int, seed: int = 0) -> Window:
    """A window of a turning ego. Each frame has its own calibration. All frames and cameras are valid."""
    rng = np.random.default_rng(seed)
    rig = config.num_cameras, config.image.width_px, config.image.height_px
    past_T_now, time_delta_s = [np.eye(4)], [0.0]
    for _ in range(num_frames - 1):
        step = rigid(rng.uniform(-0.1, 0.1), *rng.uniform(-0.02, 0.02, 2), (rng.uniform(2, 5), 0.2, 0.05))
        past_T_now.append(step @ past_T_now[-1])
        time_delta_s.append(time_delta_s[-1] + rng.uniform(0.4, 0.6))
    return Window(
        image_T_ego=torch.stack([ring_of_cameras(*rig, seed=seed + t) for t in range(num_frames)]),
        past_T_now=torch.tensor(np.stack(past_T_now), dtype=torch.float32),
        time_delta_s=torch.tensor(time_delta_s, dtype=torch.float32),
        frame_valid=torch.ones(num_frames, dtype=torch.bool),
        camera_valid=torch.ones(num_frames, config.num_cameras, dtype=torch.bool),
    )


def random_images(config: DuoSpaceNetConfig, num_frames: int, seed: int = 0) -> Tensor:
    """Random images (T, N, H, W, 3) uint8."""
    shape = num_frames, config.num_cameras, config.image.height_px, config.image.width_px, 3
    return torch.randint(0, 256, shape, dtype=torch.uint8, generator=torch.Generator().manual_seed(seed))


def pv_features(config: DuoSpaceNetConfig, seed: int = 0) -> list[Tensor]:
    """Random F_PV^j (N, C, H_j, W_j) at strides 8, 16, 32 and 64, rounded up."""
    return [
        normal(
            config.num_cameras,
            config.channels,
            -(-config.image.height_px // stride),
            -(-config.image.width_px // stride),
            seed=seed + stride,
        )
        for stride in (8, 16, 32, 64)
    ]


def bev_features(config: DuoSpaceNetConfig, seed: int = 0) -> Tensor:
    """Random F_BEV (1, C, X, Y)."""
    return normal(1, config.channels, *config.voxels.size[:2], seed=seed)
