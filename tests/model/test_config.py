"""Configurations: the paper's numbers, and the way through JSON and back."""

import json
from dataclasses import FrozenInstanceError, replace

import pytest

from duospacenet.model import PRESETS, DuoSpaceNetConfig
from duospacenet.model.config import VoVNetConfig, VoxelGrid
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


def test_the_small_preset_takes_the_caffe_kind_of_imagenet_weights():
    assert SMALL.backbone.caffe_style
    assert SMALL.backbone.batch_norm_eps == 1.001e-5
    assert (SMALL.image.colour_order, SMALL.image.std) == ("bgr", (1, 1, 1))
    assert SMALL.image.mean == (103.939, 116.779, 123.68)


def test_the_classes_stand_in_the_order_of_the_published_checkpoints():
    expected = "car truck construction_vehicle bus trailer barrier motorcycle bicycle pedestrian traffic_cone"
    assert " ".join(SMALL.classes) == expected
    assert SMALL.map_classes == ("drivable_area", "lane_boundary")


@pytest.mark.parametrize(
    ("preset", "image_px", "voxels", "depths", "num_layers", "num_frames"),
    [("tiny", (160, 64), (16, 16, 4), (1, 1, 1, 1), 2, 4), ("nano", (400, 160), (64, 64, 4), (2, 2, 2, 2), 2, 4)],
)
def test_the_smaller_presets_are_the_designs(preset, image_px, voxels, depths, num_layers, num_frames):
    config = PRESETS[preset]
    assert config.preset == preset
    assert (config.image.width_px, config.image.height_px) == image_px
    assert config.voxels.size == voxels
    assert (config.backbone.block, config.backbone.depths) == ("basic", depths)
    assert (config.num_layers, config.num_frames) == (num_layers, num_frames)


@pytest.mark.parametrize("preset", PRESETS)
def test_a_configuration_comes_back_from_json_the_same(preset):
    config = replace(PRESETS[preset], num_queries=78, classes=("car", "tram"))
    values = json.loads(json.dumps(config.to_dict()))
    before = json.dumps(values)
    restored = DuoSpaceNetConfig.from_dict(values)
    assert restored == config
    assert hash(restored) == hash(config)  # tuples, not lists
    assert json.dumps(values) == before


@pytest.mark.parametrize(
    "spoil",
    [
        lambda values: values.pop("image"),
        lambda values: values.pop("preset"),
        lambda values: values["voxels"].pop("size"),
        lambda values: values.update(number_of_queries=3),
        lambda values: values["backbone"].update(dcn=True),
    ],
)
def test_a_missing_or_an_unknown_field_is_refused(spoil):
    values = SMALL.to_dict()
    spoil(values)
    with pytest.raises(ValueError):
        DuoSpaceNetConfig.from_dict(values)


def test_basic_blocks_cannot_be_deformable():
    with pytest.raises(ValueError, match=r"deformable_stages: expected none for basic blocks.*; got \(3, 4\)"):
        replace(PRESETS["nano"].backbone, deformable_stages=(3, 4))


def test_a_configuration_knows_whether_it_is_deformable():
    assert [name for name, config in PRESETS.items() if config.is_deformable] == ["base"]


def test_a_configuration_cannot_be_changed():
    with pytest.raises(FrozenInstanceError):
        SMALL.num_queries = 3
    with pytest.raises(FrozenInstanceError):
        SMALL.image.width_px = 3


def test_pv_alone_has_no_bev_to_fuse_and_two_sets_of_queries_are_of_one_size():
    with pytest.raises(ValueError, match="bev_temporal: expected queries where only PV is looked into; got stacking"):
        replace(PRESETS["tiny-pv"], bev_temporal="stacking")
    with pytest.raises(ValueError, match="num_queries: expected an even number for two sets of queries; got 31"):
        replace(PRESETS["tiny-unshared"], num_queries=31)


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


def test_what_no_layer_could_compute_is_refused_by_its_field():
    with pytest.raises(
        ValueError, match=r"voxels.size: expected X and Y divisible by 4 to draw a map; got \(13, 8, 4\)"
    ):
        replace(PRESETS["tiny"], voxels=VoxelGrid((13, 8, 4)))
    assert replace(PRESETS["tiny"], voxels=VoxelGrid((13, 8, 4)), map_classes=()).voxels.size == (13, 8, 4)
    with pytest.raises(ValueError, match="channels: expected a multiple of the 4 heads; got 30"):
        replace(PRESETS["tiny"], channels=30)
