"""What a DuoSpaceNet is made of: frozen dataclasses, and the presets by name."""

from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

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


@dataclass(frozen=True)
class ImageConfig:
    """The images the encoder sees, and their normalisation `(pixel - mean) / std` on the 0..255 scale."""

    width_px: int
    height_px: int
    colour_order: Literal["rgb", "bgr"] = "rgb"
    mean: tuple[float, float, float] = (123.675, 116.28, 103.53)
    std: tuple[float, float, float] = (58.395, 57.12, 57.375)


@dataclass(frozen=True)
class ResNetConfig:
    """A ResNet in torchvision's layout.

    caffe_style: the stride of a bottleneck lies in its first 1×1 convolution instead of the 3×3.
    """

    block: Literal["basic", "bottleneck"]
    depths: tuple[int, int, int, int]
    width: int = 64
    caffe_style: bool = False
    batch_norm_eps: float = 1e-5


@dataclass(frozen=True)
class VoxelGrid:
    """X×Y×Z voxels over a box of the ego frame; its X×Y cells are also those of the BEV features."""

    size: tuple[int, int, int]
    lower_m: tuple[float, float, float] = (-51.2, -51.2, -3.0)
    upper_m: tuple[float, float, float] = (51.2, 51.2, 5.0)


@dataclass(frozen=True)
class DuoSpaceNetConfig:
    """One DuoSpaceNet. `num_frames` counts the current frame too."""

    preset: str
    image: ImageConfig
    backbone: ResNetConfig
    voxels: VoxelGrid
    num_layers: int = 2
    num_queries: int = 900
    num_frames: int = 4
    num_cameras: int = 6
    channels: int = 256
    voxel_channels: int = 64
    segmentation_channels: int = 32
    feedforward_channels: int = 1024
    num_heads: int = 8
    pv_points: int = 4
    bev_points: int = 16
    classes: tuple[str, ...] = NUSCENES_CLASSES
    map_classes: tuple[str, ...] = ("drivable_area", "lane_boundary")

    def to_dict(self) -> dict[str, Any]:
        """The configuration as plain JSON values."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> "DuoSpaceNetConfig":
        """The inverse of `to_dict`. Raises TypeError or KeyError for fields that are missing or unknown."""
        values = _tuples(values)
        values["image"] = ImageConfig(**values["image"])
        values["backbone"] = ResNetConfig(**values["backbone"])
        values["voxels"] = VoxelGrid(**values["voxels"])
        return cls(**values)


def _tuples(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _tuples(item) for key, item in value.items()}
    return tuple(map(_tuples, value)) if isinstance(value, (list, tuple)) else value


# The ImageNet weights of the caffe kind that the paper's family starts from see BGR less its mean.
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
