"""The configuration of a DuoSpaceNet: frozen dataclasses that check their values when they are created."""

import json
from dataclasses import asdict
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Discriminator, Field, Tag, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass

from .config_errors import describe_error

FiniteFloat = Annotated[float, Field(allow_inf_nan=False)]
PositiveFloat = Annotated[float, Field(gt=0, allow_inf_nan=False)]
# The limits are far above every use. Without them, the configuration in a bundle from someone else could ask for any
# amount of memory and time.
PositiveInt = Annotated[int, Field(gt=0, le=2**16)]
Count = Annotated[int, Field(gt=0, le=256)]  # of frames, cameras, and parts of the network
ClassName = Annotated[str, Field(min_length=1)]
MapClassName = Annotated[str, Field(pattern="^[A-Za-z_][A-Za-z0-9_]*$")]  # also names a module and a graph output
NO_OTHER_FIELDS = ConfigDict(extra="forbid")

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


@dataclass(frozen=True, config=NO_OTHER_FIELDS)
class ImageConfig:
    """The size [px] of the input images and their normalisation, `(pixel - mean) / std`, for pixels from 0 to 255.

    colour_order: the channel order that the backbone was trained with. It is also the order of `mean` and `std`.
    """

    width_px: PositiveInt
    height_px: PositiveInt
    colour_order: Literal["rgb", "bgr"] = "rgb"
    mean: tuple[FiniteFloat, FiniteFloat, FiniteFloat] = (123.675, 116.28, 103.53)
    std: tuple[PositiveFloat, PositiveFloat, PositiveFloat] = (58.395, 57.12, 57.375)


@dataclass(frozen=True, config=NO_OTHER_FIELDS)
class ResNetConfig:
    """A ResNet with torchvision's structure.

    depths: number of blocks in each of the four stages.
    width: channels of the first stage.
    caffe_style: a bottleneck has its stride in the first 1×1 convolution instead of the 3×3 convolution.
    deformable_stages: the stages, 1 to 4, in which the 3×3 convolution of each bottleneck is a DCNv2. Stage 1 is
        torchvision's layer1 (C2), stage 4 is layer4 (C5).

    Raises ValueError for deformable stages with basic blocks. mmdetection does not support those either.
    """

    block: Literal["basic", "bottleneck"]
    depths: tuple[Count, Count, Count, Count]
    width: PositiveInt = 64
    caffe_style: bool = False
    batch_norm_eps: PositiveFloat = 1e-5
    deformable_stages: tuple[Literal[1, 2, 3, 4], ...] = ()

    def __post_init__(self) -> None:
        if self.deformable_stages and self.block != "bottleneck":
            raise ValueError(
                f"deformable_stages: expected an empty list with {self.block} blocks; got {self.deformable_stages}. "
                "Only bottleneck blocks can be deformable."
            )


@dataclass(frozen=True, config=NO_OTHER_FIELDS)
class VoVNetConfig:
    """A VoVNet with effective squeeze-and-excitation (eSE), with the structure of the published weights.

    stem: output channels of the three convolutions of the stem.
    depths: number of one-shot aggregation (OSA) modules in each of the four stages, C2 to C5.
    widths: channels of the 3×3 convolutions of each stage.
    out_channels: output channels of each stage.
    num_convolutions: number of 3×3 convolutions in an OSA module.
    """

    stem: tuple[PositiveInt, PositiveInt, PositiveInt] = (64, 64, 128)
    depths: tuple[Count, Count, Count, Count] = (1, 3, 9, 3)
    widths: tuple[PositiveInt, PositiveInt, PositiveInt, PositiveInt] = (128, 160, 192, 224)
    out_channels: tuple[PositiveInt, PositiveInt, PositiveInt, PositiveInt] = (256, 512, 768, 1024)
    num_convolutions: Count = 5
    batch_norm_eps: PositiveFloat = 1e-5


def _backbone_type(values: Any) -> str:
    """The name of the configuration class for the values of the field `backbone`."""
    only_vovnet = ("stem", "widths", "out_channels", "num_convolutions")
    is_vovnet = isinstance(values, VoVNetConfig) or (isinstance(values, dict) and any(n in values for n in only_vovnet))
    return "VoVNetConfig" if is_vovnet else "ResNetConfig"


# Without a discriminator, pydantic would report the errors of both backbone types, also of the one that is not meant.
BackboneConfig = Annotated[
    Annotated[ResNetConfig, Tag("ResNetConfig")] | Annotated[VoVNetConfig, Tag("VoVNetConfig")],
    Discriminator(_backbone_type),
]


@dataclass(frozen=True, config=NO_OTHER_FIELDS)
class VoxelGrid:
    """A grid of X×Y×Z voxels over a box of the ego frame [m]. The BEV features have the same X×Y cells."""

    size: tuple[PositiveInt, PositiveInt, PositiveInt]
    lower_m: tuple[FiniteFloat, FiniteFloat, FiniteFloat] = (-51.2, -51.2, -3.0)
    upper_m: tuple[FiniteFloat, FiniteFloat, FiniteFloat] = (51.2, 51.2, 5.0)

    def __post_init__(self) -> None:
        if any(lower >= upper for lower, upper in zip(self.lower_m, self.upper_m, strict=True)):
            raise ValueError(f"upper_m: expected values above lower_m, {self.lower_m}; got {self.upper_m}")


@dataclass(frozen=True, config=NO_OTHER_FIELDS)
class DuoSpaceNetConfig:
    """The configuration of a DuoSpaceNet, or of a model in the paper's ablation tables.

    preset: the name of the configuration. Any name is allowed.
    num_frames: T, the frames of the temporal window, including the current one.
    channels: C, of the PV and BEV features and of a content embedding.
    voxel_channels: channels of the voxel features.
    pv_points, bev_points: sampling points per feature level and head.
    queries: the kind of object queries.
        "duo": one pose, and one content embedding for each space.
        "shared_content": one pose and one content embedding, which attends to PV and then to BEV.
        "unshared": two sets of queries. One attends to BEV only, the other to PV only.
        "bev", "pv": one pose and one content embedding, which attends to the named space only.
    bev_temporal: how past BEV features are used. PV always uses temporal queries.
        "queries": by the paper's temporal queries.
        "stacking": the BEV features of the window are fused by recurrent stacking.
        "attention": the BEV features of the window are fused by BEVFormer's temporal self-attention.
    divergence_enhancement: apply feature divergence enhancement (FDE) between the voxels and the BEV features.
    classes: names of the object classes, in the order of the class logits.
    map_classes: names of the map classes. With an empty list the model has no segmentation.

    Raises ValueError, naming the field, for values that do not fit together.
    """

    preset: str
    image: ImageConfig
    backbone: BackboneConfig
    voxels: VoxelGrid
    num_layers: Count = 2
    num_queries: PositiveInt = 900
    num_frames: Count = 4
    num_cameras: Count = 6
    channels: PositiveInt = 256
    voxel_channels: PositiveInt = 64
    segmentation_channels: PositiveInt = 32
    feedforward_channels: PositiveInt = 1024
    num_heads: PositiveInt = 8
    pv_points: PositiveInt = 4
    bev_points: PositiveInt = 16
    queries: Literal["duo", "shared_content", "unshared", "bev", "pv"] = "duo"
    bev_temporal: Literal["queries", "stacking", "attention"] = "queries"
    divergence_enhancement: bool = True
    classes: Annotated[tuple[ClassName, ...], Field(min_length=1)] = NUSCENES_CLASSES
    map_classes: tuple[MapClassName, ...] = ("drivable_area", "lane_boundary")

    def __post_init__(self) -> None:
        if self.fuses_bev and not self.attends_bev:
            raise ValueError(
                f'bev_temporal: expected "queries" because the queries attend to PV only; got "{self.bev_temporal}"'
            )
        if self.map_classes and any(cells % 4 for cells in self.voxels.size[:2]):
            raise ValueError(
                f"voxels.size: expected X and Y divisible by 4 for the map segmentation; got {self.voxels.size}"
            )
        if self.channels % self.num_heads:
            raise ValueError(f"channels: expected a multiple of num_heads, {self.num_heads}; got {self.channels}")
        if self.queries == "unshared" and self.num_queries % 2:
            raise ValueError(f"num_queries: expected an even number for two sets of queries; got {self.num_queries}")
        for field, names in (("classes", self.classes), ("map_classes", self.map_classes)):
            if len(set(names)) < len(names):
                raise ValueError(f"{field}: expected different names; got {', '.join(names)}")

    @property
    def attends_bev(self) -> bool:
        """Whether queries attend to BEV features."""
        return self.queries != "pv"

    @property
    def attends_pv(self) -> bool:
        """Whether queries attend to PV features."""
        return self.queries != "bev"

    @property
    def fuses_bev(self) -> bool:
        """Whether the BEV features of the window are fused into one map before the queries attend to them."""
        return self.bev_temporal != "queries"

    @property
    def content_channels(self) -> int:
        """Channels of a query's content: 2C with one content embedding per space, otherwise C."""
        return 2 * self.channels if self.queries == "duo" else self.channels

    @property
    def is_deformable(self) -> bool:
        """Whether the backbone has deformable convolutions."""
        return isinstance(self.backbone, ResNetConfig) and bool(self.backbone.deformable_stages)

    @property
    def has_bev(self) -> bool:
        """Whether the model computes BEV features, for the queries or for the map segmentation."""
        return self.attends_bev or bool(self.map_classes)

    def to_dict(self) -> dict[str, Any]:
        """The configuration as nested dictionaries and lists, for JSON and TOML files.

        It equals the configuration read back from such a file: tuples are lists, and there is no None.
        """
        return json.loads(json.dumps(asdict(self)))

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> "DuoSpaceNetConfig":
        """The inverse of `to_dict`. Fields with a default may be missing. A removed field may be present if it is off.

        Raises ValueError for an unknown, missing or wrong field. The message starts with the field's name, such as
        `voxels.size`, and names the allowed values.
        """
        # Strict mode refuses "32", 32.0 and true where an integer is expected. It accepts a list for a tuple in JSON
        # only. `default=str` turns the dates of TOML files, which no field accepts, into strings.
        try:
            return TypeAdapter(cls).validate_json(json.dumps(_current_fields(values), default=str), strict=True)
        except ValidationError as error:
            raise ValueError(describe_error(error, _TABLES)) from None


def _current_fields(values: Any) -> Any:
    """The values without the removed field `relu_before_extra_level`, if it is false, as in every model since.

    Raises ValueError if it is true, because no configuration describes such a model any more.
    """
    if not isinstance(values, dict) or not isinstance(values.get(_REMOVED_FIELD), bool):
        return values
    if values[_REMOVED_FIELD]:
        raise ValueError(
            f"{_REMOVED_FIELD}: expected false; got true. The last version with a ReLU before the fourth pyramid level "
            "is 0.2.0; weights that were trained with it are worse without it"
        )
    return {name: value for name, value in values.items() if name != _REMOVED_FIELD}


_REMOVED_FIELD = "relu_before_extra_level"  # version 0.2.0 wrote it into every configuration

_TABLES: dict[str, type] = {
    "": DuoSpaceNetConfig,
    "image": ImageConfig,
    "ResNetConfig": ResNetConfig,
    "VoVNetConfig": VoVNetConfig,
    "voxels": VoxelGrid,
}
