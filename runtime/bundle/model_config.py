"""The configuration of the model in a bundle's manifest.

The fields are those of `duospacenet.model.config`, which needs PyTorch's package. A test compares both. Whether the
values fit together is checked there, when the model is built.
"""

from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag

from ..json_record import FiniteFloat, Flag, JsonRecord, PositiveFloat
from .preprocessing_record import Length, Normalisation
from .temporal_window import Count

ClassName = Annotated[str, Field(min_length=1)]
MapClassName = Annotated[str, Field(pattern="^[A-Za-z_][A-Za-z0-9_]*$")]  # also names a graph output


class ImageSettings(Normalisation):
    """The size of the input images [px], and their normalisation in the backbone."""

    width_px: Length
    height_px: Length


class ResNetSettings(JsonRecord):
    """A ResNet with torchvision's structure. deformable_stages: the stages with deformable convolutions."""

    block: Literal["basic", "bottleneck"]
    depths: tuple[Count, Count, Count, Count]
    width: Length
    caffe_style: Flag
    batch_norm_eps: PositiveFloat
    deformable_stages: tuple[Literal[1, 2, 3, 4], ...]


class VoVNetSettings(JsonRecord):
    """A VoVNet with effective squeeze-and-excitation."""

    stem: tuple[Length, Length, Length]
    depths: tuple[Count, Count, Count, Count]
    widths: tuple[Length, Length, Length, Length]
    out_channels: tuple[Length, Length, Length, Length]
    num_convolutions: Count
    batch_norm_eps: PositiveFloat


class VoxelSettings(JsonRecord):
    """The grid of X×Y×Z voxels over a box of the ego frame [m]."""

    size: tuple[Length, Length, Length]
    lower_m: tuple[FiniteFloat, FiniteFloat, FiniteFloat]
    upper_m: tuple[FiniteFloat, FiniteFloat, FiniteFloat]


def _backbone_type(values: Any) -> str:
    """The type of backbone of a record, or of the JSON values of the field `backbone`."""
    only_vovnet = ("stem", "widths", "out_channels", "num_convolutions")
    is_vovnet = isinstance(values, dict) and any(name in values for name in only_vovnet)
    return "VoVNet" if is_vovnet or isinstance(values, VoVNetSettings) else "ResNet"


# Without a discriminator, the errors of both types would be reported.
BackboneSettings = Annotated[
    Annotated[ResNetSettings, Tag("ResNet")] | Annotated[VoVNetSettings, Tag("VoVNet")], Discriminator(_backbone_type)
]


class ModelConfig(JsonRecord):
    """The configuration of the exported DuoSpaceNet. A consumer does not need it.

    preset: the name of the configuration.
    num_frames: T, the frames of the temporal window, including the current one.
    queries: the kind of object queries. bev_temporal: how past BEV features are used.
    classes, map_classes: as in the manifest.
    relu_before_extra_level: not written any more. Earlier bundles have it; their graphs contain the ReLU if it is true.
    """

    preset: str
    image: ImageSettings
    backbone: BackboneSettings
    voxels: VoxelSettings
    num_layers: Count
    num_queries: Length
    num_frames: Count
    num_cameras: Count
    channels: Length
    voxel_channels: Length
    segmentation_channels: Length
    feedforward_channels: Length
    num_heads: Length
    pv_points: Length
    bev_points: Length
    queries: Literal["duo", "shared_content", "unshared", "bev", "pv"]
    bev_temporal: Literal["queries", "stacking", "attention"]
    divergence_enhancement: Flag
    classes: Annotated[tuple[ClassName, ...], Field(min_length=1)]
    map_classes: tuple[MapClassName, ...]
    relu_before_extra_level: Annotated[Flag, Field(deprecated=True)] = False
