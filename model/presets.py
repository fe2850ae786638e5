"""The presets: the paper's models, smaller models, and the rows of the paper's ablation tables."""

from dataclasses import replace
from typing import Any

from .config import DuoSpaceNetConfig, ImageConfig, ResNetConfig, VoVNetConfig, VoxelGrid

# Caffe-style ImageNet weights expect BGR images minus this mean.
_CAFFE_MEAN = (103.939, 116.779, 123.68)

_SMALL = DuoSpaceNetConfig(
    preset="small",
    image=ImageConfig(800, 320, "bgr", _CAFFE_MEAN, (1.0, 1.0, 1.0)),
    backbone=ResNetConfig("bottleneck", (3, 4, 6, 3), caffe_style=True, batch_norm_eps=1.001e-5),
    voxels=VoxelGrid((100, 100, 4)),
)

_NANO = replace(
    _SMALL,
    preset="nano",
    image=ImageConfig(400, 160),
    backbone=ResNetConfig("basic", (2, 2, 2, 2), width=32),
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

# FCOS3D's weights, from which related detectors start, expect BGR images minus Detectron's mean.
_DETECTRON_MEAN = (103.53, 116.28, 123.675)

_BASE = replace(
    _SMALL,
    preset="base",
    image=ImageConfig(1600, 640, "bgr", _DETECTRON_MEAN, (1.0, 1.0, 1.0)),
    backbone=ResNetConfig("bottleneck", (3, 4, 23, 3), caffe_style=True, deformable_stages=(3, 4)),
    voxels=VoxelGrid((200, 200, 4)),
    num_layers=4,
)

_LARGE = replace(
    _BASE,
    preset="large",
    image=ImageConfig(1600, 640, "bgr", _DETECTRON_MEAN, (57.375, 57.12, 58.395)),
    backbone=VoVNetConfig(),
)

# The models of the paper's ablation tables, except the full model, by the suffix that is added to a preset's name.
ABLATIONS: dict[str, dict[str, Any]] = {
    "bev": {"queries": "bev"},
    "bev-no-fde": {"queries": "bev", "divergence_enhancement": False},
    "pv": {"queries": "pv", "map_classes": ()},
    "no-fde": {"divergence_enhancement": False},
    "unshared": {"queries": "unshared"},
    "shared-content": {"queries": "shared_content"},
    "stacking": {"bev_temporal": "stacking"},
    "attention": {"bev_temporal": "attention"},
}


def ablate(config: DuoSpaceNetConfig, name: str) -> DuoSpaceNetConfig:
    """The configuration of the ablation `name`, a key of `ABLATIONS`, at the size of `config`."""
    return replace(config, preset=f"{config.preset}-{name}", **ABLATIONS[name])


# Ablations exist for `small`, the paper's ablation setting, and for the presets that are trained and tested here.
PRESETS: dict[str, DuoSpaceNetConfig] = {
    config.preset: config
    for config in (
        *(row for size in (_TINY, _NANO, _SMALL) for row in (size, *(ablate(size, name) for name in ABLATIONS))),
        _BASE,
        _LARGE,
    )
}
