"""What a DuoSpaceNet is made of: frozen dataclasses, checked when they are made, and the presets by name."""

from dataclasses import asdict, replace
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, TypeAdapter
from pydantic.dataclasses import dataclass

Positive = Annotated[int, Field(gt=0)]
STRICT = ConfigDict(extra="forbid")

NUSCENES_CLASSES = (
    "car",
    "truck",
    "construction_vehicle",
    "bus",
    "trailer",
    "barrier",
    "motorcycle",
    "bicycle",
    "pedestrian",
    "traffic_cone",
)


@dataclass(frozen=True, config=STRICT)
class ImageConfig:
    """The images the encoder sees, and their normalisation `(pixel - mean) / std` on the 0..255 scale."""

    width_px: Positive
    height_px: Positive
    colour_order: Literal["rgb", "bgr"] = "rgb"
    mean: tuple[float, float, float] = (123.675, 116.28, 103.53)
    std: tuple[float, float, float] = (58.395, 57.12, 57.375)


@dataclass(frozen=True, config=STRICT)
class ResNetConfig:
    """A ResNet in torchvision's layout.

    caffe_style: the stride of a bottleneck lies in its first 1×1 convolution instead of the 3×3.
    """

    block: Literal["basic", "bottleneck"]
    depths: tuple[Positive, Positive, Positive, Positive]
    width: Positive = 64
    caffe_style: bool = False
    batch_norm_eps: float = 1e-5


@dataclass(frozen=True, config=STRICT)
class VoxelGrid:
    """X×Y×Z voxels over a box of the ego frame; its X×Y cells are also those of the BEV features."""

    size: tuple[Positive, Positive, Positive]
    lower_m: tuple[float, float, float] = (-51.2, -51.2, -3.0)
    upper_m: tuple[float, float, float] = (51.2, 51.2, 5.0)


@dataclass(frozen=True, config=STRICT)
class DuoSpaceNetConfig:
    """One DuoSpaceNet. `num_frames` counts the current frame too."""

    preset: str
    image: ImageConfig
    backbone: ResNetConfig
    voxels: VoxelGrid
    num_layers: Positive = 2
    num_queries: Positive = 900
    num_frames: Positive = 4
    num_cameras: Positive = 6
    channels: Positive = 256
    voxel_channels: Positive = 64
    segmentation_channels: Positive = 32
    feedforward_channels: Positive = 1024
    num_heads: Positive = 8
    pv_points: Positive = 4
    bev_points: Positive = 16
    classes: tuple[str, ...] = NUSCENES_CLASSES
    map_classes: tuple[str, ...] = ("drivable_area", "lane_boundary")

    def to_dict(self) -> dict[str, Any]:
        """The configuration as plain JSON values."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> "DuoSpaceNetConfig":
        """The inverse of `to_dict`. Raises ValueError for a field that is missing, unknown or of the wrong type."""
        return TypeAdapter(cls).validate_python(values)


# What ImageNet weights of the caffe kind see: BGR less its mean.
_CAFFE = {"colour_order": "bgr", "mean": (103.939, 116.779, 123.68), "std": (1.0, 1.0, 1.0)}

_SMALL = DuoSpaceNetConfig(
    preset="small",
    image=ImageConfig(800, 320, **_CAFFE),  # type: ignore[arg-type]
    backbone=ResNetConfig("bottleneck", (3, 4, 6, 3), caffe_style=True, batch_norm_eps=1.001e-5),
    voxels=VoxelGrid((100, 100, 4)),
)

_NANO = replace(
    _SMALL,
    preset="nano",
    image=ImageConfig(400, 160),
    backbone=ResNetConfig("basic", (2, 2, 2, 2)),
    voxels=VoxelGrid((64, 64, 4)),
    num_queries=200,
    channels=128,
    voxel_channels=32,
    feedforward_channels=512,
    bev_points=8,
)

_TINY = replace(
    _NANO,
    preset="tiny",
    image=ImageConfig(160, 64),
    backbone=ResNetConfig("basic", (1, 1, 1, 1), width=8),
    voxels=VoxelGrid((16, 16, 4)),
    num_queries=32,
    channels=32,
    voxel_channels=8,
    segmentation_channels=8,
    feedforward_channels=64,
    num_heads=4,
    pv_points=2,
    bev_points=4,
)

PRESETS: dict[str, DuoSpaceNetConfig] = {config.preset: config for config in (_TINY, _NANO, _SMALL)}
