"""The presets have the sizes of the paper, or fixed smaller sizes for tests and CPUs."""

import pytest

from duospacenet.model import PRESETS
from duospacenet.model.config import VoVNetConfig
from duospacenet.model.image_encoder import NUM_LEVELS

SMALL = PRESETS["small"]


def test_the_small_preset_is_the_papers_ablation_setting():
    assert (SMALL.image.width_px, SMALL.image.height_px) == (800, 320)
    assert (SMALL.backbone.block, SMALL.backbone.depths, SMALL.backbone.width) == ("bottleneck", (3, 4, 6, 3), 64)
    assert SMALL.voxels.size == (100, 100, 4)
    assert SMALL.voxels.lower_m == (-51.2, -51.2, -3)
    assert SMALL.voxels.upper_m == (51.2, 51.2, 5)
    assert (SMALL.num_layers, SMALL.num_queries, SMALL.num_frames, SMALL.num_cameras) == (2, 900, 4, 6)
    assert (SMALL.channels, SMALL.voxel_channels, SMALL.feedforward_channels) == (256, 64, 1024)
    assert SMALL.num_heads == 8
    # 16 sampling offsets per query and head in each space.
    assert NUM_LEVELS * SMALL.pv_points == 16
    assert SMALL.bev_points == 16


def test_the_small_preset_fits_caffe_style_imagenet_weights():
    assert SMALL.backbone.caffe_style
    assert SMALL.backbone.batch_norm_eps == 1.001e-5
    assert (SMALL.image.colour_order, SMALL.image.std) == ("bgr", (1, 1, 1))
    assert SMALL.image.mean == (103.939, 116.779, 123.68)


def test_the_classes_have_the_order_of_the_published_checkpoints():
    expected = "car truck construction_vehicle bus trailer barrier motorcycle bicycle pedestrian traffic_cone"
    assert " ".join(SMALL.classes) == expected
    assert SMALL.map_classes == ("drivable_area", "lane_boundary")


@pytest.mark.parametrize(
    ("preset", "image_px", "voxels", "depths", "num_layers", "num_frames"),
    [("tiny", (160, 64), (16, 16, 4), (1, 1, 1, 1), 2, 4), ("nano", (400, 160), (64, 64, 4), (2, 2, 2, 2), 2, 4)],
)
def test_tiny_and_nano_keep_their_sizes(preset, image_px, voxels, depths, num_layers, num_frames):
    config = PRESETS[preset]
    assert config.preset == preset
    assert (config.image.width_px, config.image.height_px) == image_px
    assert config.voxels.size == voxels
    assert (config.backbone.block, config.backbone.depths) == ("basic", depths)
    assert (config.num_layers, config.num_frames) == (num_layers, num_frames)


def test_the_large_presets_are_the_papers_val_and_test_settings():
    base, large = PRESETS["base"], PRESETS["large"]
    for config in (base, large):
        assert (config.image.width_px, config.image.height_px) == (1600, 640)
        assert config.voxels.size == (200, 200, 4)
        assert (config.num_layers, config.num_queries, config.num_frames) == (4, 900, 4)
        assert (config.channels, config.num_heads, config.feedforward_channels) == (256, 8, 1024)
    assert (base.backbone.depths, base.backbone.deformable_stages) == ((3, 4, 23, 3), (3, 4))  # ResNet-101-DCN
    assert isinstance(large.backbone, VoVNetConfig)
    assert large.backbone.depths == (1, 3, 9, 3)  # V2-99


def test_base_is_the_only_preset_with_deformable_convolutions():
    assert [name for name, config in PRESETS.items() if config.is_deformable] == ["base"]
