"""What a DuoSpaceNet is made of: frozen dataclasses, checked when they are made."""

from dataclasses import asdict
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
    deformable_stages: of 1 to 4, those in which the 3×3 convolutions of the bottlenecks are DCNv2 (torchvision counts
    them as layer1 to layer4, C2 to C5). Raises ValueError for basic blocks, which mmdetection does not deform either.
    """

    block: Literal["basic", "bottleneck"]
    depths: tuple[Positive, Positive, Positive, Positive]
    width: Positive = 64
    caffe_style: bool = False
    batch_norm_eps: float = 1e-5
    deformable_stages: tuple[Literal[1, 2, 3, 4], ...] = ()

    def __post_init__(self) -> None:
        if self.deformable_stages and self.block != "bottleneck":
            raise ValueError(
                f"deformable_stages: expected none for {self.block} blocks, in which there is no DCNv2; "
                f"got {self.deformable_stages}. Take bottlenecks."
            )


@dataclass(frozen=True, config=STRICT)
class VoVNetConfig:
    """A VoVNet with effective squeeze-and-excitation (eSE), in the layout of the published weights.

    stem: channels of its three convolutions. By stage, C2 to C5: depths, one-shot aggregation (OSA) modules; widths,
    channels of a module's convolutions; out_channels, what a module aggregates them to. num_convolutions: of a module.
    """

    stem: tuple[Positive, Positive, Positive] = (64, 64, 128)
    depths: tuple[Positive, Positive, Positive, Positive] = (1, 3, 9, 3)
    widths: tuple[Positive, Positive, Positive, Positive] = (128, 160, 192, 224)
    out_channels: tuple[Positive, Positive, Positive, Positive] = (256, 512, 768, 1024)
    num_convolutions: Positive = 5
    batch_norm_eps: float = 1e-5


@dataclass(frozen=True, config=STRICT)
class VoxelGrid:
    """X×Y×Z voxels over a box of the ego frame; its X×Y cells are also those of the BEV features."""

    size: tuple[Positive, Positive, Positive]
    lower_m: tuple[float, float, float] = (-51.2, -51.2, -3.0)
    upper_m: tuple[float, float, float] = (51.2, 51.2, 5.0)


@dataclass(frozen=True, config=STRICT)
class DuoSpaceNetConfig:
    """One DuoSpaceNet, or one row of the paper's ablation tables. `num_frames` counts the current frame too.

    queries: what an object query is, and where it looks. "duo": a pose and a content embedding for each space;
        "shared_content": one content embedding, which looks into PV and BEV in turn; "unshared": two sets of queries,
        each with poses, contents and a space of its own; "bev", "pv": there is one space to look into.
    bev_temporal: how the past comes into BEV. "queries": the temporal queries of the paper; "stacking": the window's
        BEV features are stacked recurrently; "attention": BEVFormer's temporal self-attention. PV has temporal queries.
    divergence_enhancement: whether FDE stands between the voxels and the BEV features.
    map_classes: none, and there is no segmentation.
    """

    preset: str
    image: ImageConfig
    backbone: ResNetConfig | VoVNetConfig
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
    queries: Literal["duo", "shared_content", "unshared", "bev", "pv"] = "duo"
    bev_temporal: Literal["queries", "stacking", "attention"] = "queries"
    divergence_enhancement: bool = True
    classes: tuple[str, ...] = NUSCENES_CLASSES
    map_classes: tuple[str, ...] = ("drivable_area", "lane_boundary")

    def __post_init__(self) -> None:
        if self.fuses_bev and not self.attends_bev:
            raise ValueError(f"bev_temporal: expected queries where only PV is looked into; got {self.bev_temporal}")
        if self.map_classes and any(cells % 4 for cells in self.voxels.size[:2]):
            raise ValueError(f"voxels.size: expected X and Y divisible by 4 to draw a map; got {self.voxels.size}")
        if self.channels % self.num_heads:
            raise ValueError(f"channels: expected a multiple of the {self.num_heads} heads; got {self.channels}")
        if self.queries == "unshared" and self.num_queries % 2:
            raise ValueError(f"num_queries: expected an even number for two sets of queries; got {self.num_queries}")

    @property
    def attends_bev(self) -> bool:
        """Whether queries look into the BEV features."""
        return self.queries != "pv"

    @property
    def attends_pv(self) -> bool:
        """Whether queries look into the PV features."""
        return self.queries != "bev"

    @property
    def fuses_bev(self) -> bool:
        """Whether the BEV features of the window become one before the queries look into them."""
        return self.bev_temporal != "queries"

    @property
    def content_channels(self) -> int:
        """Of a query's content: C, or C for each space."""
        return 2 * self.channels if self.queries == "duo" else self.channels

    @property
    def is_deformable(self) -> bool:
        """Whether there are deformable convolutions in the backbone."""
        return isinstance(self.backbone, ResNetConfig) and bool(self.backbone.deformable_stages)

    @property
    def has_bev(self) -> bool:
        """Whether there are BEV features: the queries look into them, or the map is drawn from them."""
        return self.attends_bev or bool(self.map_classes)

    def to_dict(self) -> dict[str, Any]:
        """The configuration as plain JSON values."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> "DuoSpaceNetConfig":
        """The inverse of `to_dict`. Raises ValueError for a field that is missing, unknown or of the wrong type."""
        return TypeAdapter(cls).validate_python(values)
