"""Random inputs of a graph over its whole legal domain, from a seed.

A graph that ignores, exchanges or freezes any element of an input differs from eager mode on such inputs. The frames of
a drive cannot show that: their cameras, poses and times are related.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import interpolate

from ...model import DuoSpaceNet
from ...model.lifter import Projector
from ...model.projection import NEAREST_DEPTH_M
from ...runtime.bundle.manifest import slot_name
from ...runtime.bundle.temporal_window import LARGEST_SPEED_M_S, LARGEST_TIME_DELTA_S
from ..graphs import Graph

# Nearby points and cameras show most of the arithmetic, but only the whole legal domain shows a clipped input.
# Every third seed therefore uses it.
_WHOLE_DOMAIN_PERIOD = 3
_NEAR_FRACTION = 0.3  # of the cameras look at a point from so close that it is around the nearest visible depth


@dataclass(frozen=True)
class _Domain:
    """The ranges of random numbers.

    translation_m: largest motion of the ego between two frames, along x, y, z.
    rotation_rad: largest roll, pitch and yaw of the ego between two frames.
    step_s: shortest and longest time between two frames.
    focal: largest focal length, as a fraction of the image width.
    position_m: largest distance of a camera from the ego's origin, along each axis.
    feature_scale: RMS of features, as a multiple of the usual RMS.
    """

    translation_m: tuple[float, float, float]
    rotation_rad: tuple[float, float, float]
    step_s: tuple[float, float]
    focal: float
    position_m: float
    feature_scale: float


_NEARBY = _Domain((15.0, 15.0, 1.5), (0.1, 0.1, 0.5), (0.05, 1.0), 0.6, 1.5, 1.0)
_WHOLE = _Domain(
    (LARGEST_SPEED_M_S * LARGEST_TIME_DELTA_S, LARGEST_SPEED_M_S * LARGEST_TIME_DELTA_S, 20.0),
    (0.5, 0.5, 3.1),
    (0.75 * LARGEST_TIME_DELTA_S, LARGEST_TIME_DELTA_S),
    4.0,
    20.0,
    10.0,
)


class RandomInputs:
    """A generator of inputs. The same seed gives the same inputs."""

    def __init__(self, model: DuoSpaceNet, scales: Mapping[str, float], seed: int) -> None:
        """scales: RMS of each float tensor by its name in a frame, as measured on eager mode's outputs."""
        self._config, self._scales = model.config, scales
        self._points = {"decoder": model.queries.pose.detach()[:, :3]}
        if model.config.has_bev:
            self._points["projector"] = _voxel_centres(model.projector)
        self._domain = _WHOLE if seed % _WHOLE_DOMAIN_PERIOD == _WHOLE_DOMAIN_PERIOD - 1 else _NEARBY
        self._generator = torch.Generator().manual_seed(seed)

    def sample(self, graph: Graph, all_valid: bool = False) -> dict[str, Tensor]:
        """Random inputs of `graph` by name.

        Rigid motions have six degrees of freedom. The calibration of every camera differs from slot to slot. Slots
        and cameras are valid at random, except for slot 0, which is always valid. An empty slot holds NaN.

        all_valid: every slot and every camera is valid.
        """
        inputs = {name: self._tensor(name, spec) for name, spec in graph.inputs.items()}
        if "image_T_ego" in inputs:
            # Only in slot 0 of the decoder are the queries at known positions.
            now = inputs["image_T_ego"][0] if graph.name == "decoder" else inputs["image_T_ego"]
            self._approach_points(now, self._points[graph.name])
        if all_valid:
            return inputs | {n: torch.ones_like(value) for n, value in inputs.items() if value.dtype == torch.bool}
        if graph.name == "decoder":
            for slot in (~inputs["frame_valid"]).nonzero().flatten().tolist():
                _empty_slot(inputs, slot)
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
            case "voxel_locations":
                return self._uniform(shape).float()
            case "voxel_visible":
                return self._uniform(shape) < 0.4
            case _:
                return self._features(shape, self._scales[name.rpartition(".")[2]])

    def _images(self, shape: tuple[int, ...]) -> Tensor:
        """Noise of a random brightness and contrast per camera and channel."""
        low, high = self._uniform((2, shape[0], 1, 1, shape[3])).sort(dim=0).values * 255
        return (low + (high - low) * self._uniform(shape)).round().to(torch.uint8)

    def _calibrations(self, shape: tuple[int, ...]) -> Tensor:
        """image_T_ego (..., N, 3, 4): camera n looks in the direction 2π n / N, up to 0.8 rad to either side."""
        cameras = shape[:-2]
        yaw = torch.arange(cameras[-1]) * (2 * torch.pi / cameras[-1]) + self._uniform(cameras, -0.8, 0.8)
        ego_R_camera = _camera_rotations(torch.stack((*self._uniform((2, *cameras), -0.2, 0.2), yaw), dim=-1))
        distance_m = self._domain.position_m
        position = self._uniform((*cameras, 3), -distance_m, distance_m) + torch.tensor([0.0, 0.0, 1.5])
        return _projections(self._intrinsics(cameras), ego_R_camera, position)

    def _approach_points(self, image_T_ego: Tensor, points: Tensor) -> None:
        """Place some cameras so close to one of `points` (Q, 3) [m] that its depth is around the smallest visible one.

        image_T_ego (N, 3, 4): is changed in place.
        """
        shape = image_T_ego.shape[:1]
        near = self._uniform(shape) < _NEAR_FRACTION
        point = points[torch.randint(len(points), shape, generator=self._generator)].double()
        ego_R_camera = _camera_rotations(self._uniform((*shape, 3), -3, 3))
        # From 0.1 to 30 % above or below, most of them close to the limit.
        distance = 10 ** self._uniform((*shape, 1), -3, -0.5) * self._uniform((*shape, 1), -1, 1).sign()
        position = point - NEAREST_DEPTH_M * (1 + distance) * ego_R_camera[..., 2]
        image_T_ego[near] = _projections(self._intrinsics(shape), ego_R_camera, position)[near]

    def _intrinsics(self, cameras: tuple[int, ...]) -> Tensor:
        image = self._config.image
        intrinsics = torch.zeros(*cameras, 3, 3, dtype=torch.float64)
        intrinsics[..., 0, 0] = image.width_px * self._uniform(cameras, 0.3, self._domain.focal)
        intrinsics[..., 1, 1] = intrinsics[..., 0, 0] * self._uniform(cameras, 0.9, 1.1)
        intrinsics[..., 0, 2] = image.width_px * self._uniform(cameras, 0.4, 0.6)
        intrinsics[..., 1, 2] = image.height_px * self._uniform(cameras, 0.4, 0.6)
        intrinsics[..., 2, 2] = 1
        return intrinsics

    def _motions(self, num_frames: int) -> Tensor:
        """past_T_now (T, 4, 4): the identity in slot 0, and rigid motions in the other slots."""
        motions = torch.eye(4, dtype=torch.float64).repeat(num_frames, 1, 1)
        angles = self._uniform((num_frames, 3), -1, 1) * torch.tensor(self._domain.rotation_rad)
        translations = self._uniform((num_frames, 3), -1, 1) * torch.tensor(self._domain.translation_m)
        motions[1:, :3, :3], motions[1:, :3, 3] = _rotations(angles)[1:], translations.cumsum(dim=0)[1:]
        return motions.float()

    def _ages(self, num_frames: int) -> Tensor:
        shortest_s, longest_s = self._domain.step_s
        steps = self._uniform((num_frames,), shortest_s, longest_s)
        steps[0] = 0
        return steps.cumsum(dim=0).float()

    def _features(self, shape: tuple[int, ...], scale: float) -> Tensor:
        """Normal noise with the RMS `scale` times that of the domain. It is smooth over a few cells, like features.

        White noise has steeper gradients than features. It would turn rounding errors of positions into differences.
        """
        height, width = shape[-2:]
        coarse = torch.randn((*shape[:-2], -(-height // 4) + 1, -(-width // 4) + 1), generator=self._generator)
        smooth = interpolate(coarse, size=(height, width), mode="bilinear", align_corners=False)
        return smooth * (scale * self._domain.feature_scale / smooth.square().mean().sqrt())

    def _uniform(self, shape: tuple[int, ...], low: float = 0.0, high: float = 1.0) -> Tensor:
        return low + (high - low) * torch.rand(shape, generator=self._generator, dtype=torch.float64)

    def _integers(self, low: int, high: int, shape: tuple[int, ...]) -> Tensor:
        return torch.randint(low, high, shape, generator=self._generator)


def _voxel_centres(projector: Projector) -> Tensor:
    """The voxel centres (X·Y·Z, 3) [m] in the ego frame."""
    return torch.cartesian_prod(projector.x, projector.y, projector.z)


def _empty_slot(inputs: dict[str, Tensor], slot: int) -> None:
    """Fill an empty slot of the decoder's inputs with NaN. Its camera flags stay random."""
    for name, value in inputs.items():
        if name.startswith(slot_name(slot, "")):
            inputs[name] = torch.full_like(value, torch.nan)
        elif "." not in name and value.is_floating_point():
            value[slot] = torch.nan


def _projections(intrinsics: Tensor, ego_R_camera: Tensor, position: Tensor) -> Tensor:
    """image_T_ego (..., 3, 4) of cameras at `position` (..., 3) [m] in the ego frame."""
    camera_R_ego = ego_R_camera.mT
    return (intrinsics @ torch.cat((camera_R_ego, -camera_R_ego @ position[..., None]), dim=-1)).float()


def _camera_rotations(angles: Tensor) -> Tensor:
    """ego_R_camera (..., 3, 3) of cameras that are turned by roll, pitch and yaw (..., 3) [rad] from looking ahead."""
    return _rotations(angles) @ torch.tensor([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]], dtype=torch.float64)


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
