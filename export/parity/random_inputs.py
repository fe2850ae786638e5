"""Random inputs of a graph over its whole legal domain, from a seed.

A graph that ignores, exchanges or freezes any element of an input differs from eager mode on such inputs. The frames of
a drive cannot show that: their cameras, poses and times are related.
"""

from collections.abc import Mapping

import torch
from torch import Tensor
from torch.nn.functional import interpolate

from ...model import DuoSpaceNetConfig
from ...model.projection import OUTSIDE
from ..graphs import Graph

# The motion between the current frame and a past one: uniform up to these values. Most queries stay visible.
_LARGEST_TRANSLATION_M = (15.0, 15.0, 1.5)
_LARGEST_ROTATION_RAD = (0.1, 0.1, 0.5)  # roll, pitch, yaw
_LARGEST_STEP_S = 1.0  # time between two frames


class RandomInputs:
    """A generator of inputs. The same seed gives the same inputs."""

    def __init__(self, config: DuoSpaceNetConfig, scales: Mapping[str, float], seed: int) -> None:
        """scales: RMS of each float tensor by its name in a frame, as measured on eager mode's outputs."""
        self._config, self._scales = config, scales
        self._generator = torch.Generator().manual_seed(seed)

    def draw(self, graph: Graph, all_valid: bool = False) -> dict[str, Tensor]:
        """Random inputs of `graph` by name.

        Rigid motions have six degrees of freedom. The calibration of every camera differs from slot to slot. Slots
        and cameras are valid at random, except for slot 0, which is always valid. An empty slot holds random values.

        all_valid: every slot and every camera is valid.
        """
        inputs = {name: self._tensor(name, spec) for name, spec in graph.inputs.items()}
        if all_valid:
            inputs |= {name: torch.ones_like(value) for name, value in inputs.items() if value.dtype == torch.bool}
        return inputs

    def _tensor(self, name: str, spec: Tensor) -> Tensor:
        shape = tuple(spec.shape)
        match name:
            case "images":
                return self._images(shape)
            case "image_T_ego":
                return self._calibrations(shape)
            case "camera_valid":
                return self._uniform(shape) < 0.5
            case "frame_valid":
                return (self._uniform(shape) < 0.8) | (torch.arange(shape[0]) == 0)
            case "past_T_now":
                return self._motions(shape[0])
            case "time_delta_s":
                return self._ages(shape[0])
            case "sampling_grid":
                return self._sampling_grid(shape)
            case "voxel_weight":
                return 1 / self._integers(1, 4, shape).float()
            case _:
                return self._features(shape, self._scales[name.rpartition(".")[2]])

    def _images(self, shape: tuple[int, ...]) -> Tensor:
        """Noise of a random brightness and contrast per camera and channel."""
        low, high = self._uniform((2, shape[0], 1, 1, shape[3])).sort(dim=0).values * 255
        return (low + (high - low) * self._uniform(shape)).round().to(torch.uint8)

    def _calibrations(self, shape: tuple[int, ...]) -> Tensor:
        """image_T_ego (..., N, 3, 4): camera n looks in the direction 2π n / N, up to 0.8 rad to either side."""
        cameras, image = shape[:-2], self._config.image
        yaw = torch.arange(cameras[-1]) * (2 * torch.pi / cameras[-1]) + self._uniform(cameras, -0.8, 0.8)
        angles = torch.stack((self._uniform(cameras, -0.2, 0.2), self._uniform(cameras, -0.2, 0.2), yaw), dim=-1)
        ego_R_camera = _rotations(angles) @ torch.tensor([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]], dtype=torch.float64)
        position = self._uniform((*cameras, 3), -1.5, 1.5) + torch.tensor([0.0, 0.0, 1.5])
        intrinsics = torch.zeros(*cameras, 3, 3, dtype=torch.float64)
        intrinsics[..., 0, 0] = image.width_px * self._uniform(cameras, 0.3, 0.6)
        intrinsics[..., 1, 1] = intrinsics[..., 0, 0] * self._uniform(cameras, 0.9, 1.1)
        intrinsics[..., 0, 2] = image.width_px * self._uniform(cameras, 0.4, 0.6)
        intrinsics[..., 1, 2] = image.height_px * self._uniform(cameras, 0.4, 0.6)
        intrinsics[..., 2, 2] = 1
        camera_R_ego = ego_R_camera.mT
        camera_T_ego = torch.cat((camera_R_ego, -camera_R_ego @ position[..., None]), dim=-1)
        return (intrinsics @ camera_T_ego).float()

    def _motions(self, num_frames: int) -> Tensor:
        """past_T_now (T, 4, 4): the identity in slot 0, and rigid motions in the other slots."""
        motions = torch.eye(4, dtype=torch.float64).repeat(num_frames, 1, 1)
        angles = self._uniform((num_frames, 3), -1, 1) * torch.tensor(_LARGEST_ROTATION_RAD)
        translations = self._uniform((num_frames, 3), -1, 1) * torch.tensor(_LARGEST_TRANSLATION_M)
        motions[1:, :3, :3], motions[1:, :3, 3] = _rotations(angles)[1:], translations[1:]
        return motions.float()

    def _ages(self, num_frames: int) -> Tensor:
        steps = self._uniform((num_frames,), 0.05, _LARGEST_STEP_S)
        steps[0] = 0
        return steps.cumsum(dim=0).float()

    def _sampling_grid(self, shape: tuple[int, ...]) -> Tensor:
        """Locations inside the images, and a quarter of them OUTSIDE, in grid_sample's coordinates."""
        locations = self._uniform(shape)
        locations[self._uniform(shape[:-1]) < 0.25] = OUTSIDE
        return (2 * locations - 1).float()

    def _features(self, shape: tuple[int, ...], scale: float) -> Tensor:
        """Normal noise with the RMS `scale`, smooth over a few cells like the features of a network.

        White noise has steeper gradients than features. It would turn rounding errors of positions into differences.
        """
        height, width = shape[-2:]
        coarse = torch.randn((*shape[:-2], -(-height // 4) + 1, -(-width // 4) + 1), generator=self._generator)
        smooth = interpolate(coarse, size=(height, width), mode="bilinear", align_corners=False)
        return smooth * (scale / smooth.square().mean().sqrt())

    def _uniform(self, shape: tuple[int, ...], low: float = 0.0, high: float = 1.0) -> Tensor:
        return low + (high - low) * torch.rand(shape, generator=self._generator, dtype=torch.float64)

    def _integers(self, low: int, high: int, shape: tuple[int, ...]) -> Tensor:
        return torch.randint(low, high, shape, generator=self._generator)


def _rotations(angles: Tensor) -> Tensor:
    """Rotation matrices (..., 3, 3) float64 of roll, pitch and yaw (..., 3) [rad], applied in this order."""
    roll, pitch, yaw = angles.double().unbind(dim=-1)
    return _about_axis(2, yaw) @ _about_axis(1, pitch) @ _about_axis(0, roll)


def _about_axis(axis: int, angle: Tensor) -> Tensor:
    """Rotations (..., 3, 3) about one of the axes x, y, z."""
    first, second = (axis + 1) % 3, (axis + 2) % 3
    rotation = torch.zeros(*angle.shape, 3, 3, dtype=angle.dtype)
    rotation[..., axis, axis] = 1
    rotation[..., first, first] = rotation[..., second, second] = angle.cos()
    rotation[..., first, second], rotation[..., second, first] = -angle.sin(), angle.sin()
    return rotation
