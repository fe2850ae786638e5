"""Configurations are checked when they are created, and can be written to files and read back."""

import json
import tomllib
from dataclasses import FrozenInstanceError, replace

import pytest

from duospacenet.model import PRESETS, DuoSpaceNetConfig
from duospacenet.model.config import ImageConfig, ResNetConfig, VoVNetConfig, VoxelGrid

SMALL = PRESETS["small"]

# --- Files --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("preset", PRESETS)
def test_a_configuration_is_the_same_after_a_round_trip_through_json(preset):
    config = replace(PRESETS[preset], num_queries=78, classes=("car", "tram"))
    values = json.loads(json.dumps(config.to_dict()))
    before = json.dumps(values)
    restored = DuoSpaceNetConfig.from_dict(values)
    assert restored == config
    assert hash(restored) == hash(config)  # tuples, not lists
    assert json.dumps(values) == before


@pytest.mark.parametrize("preset", ["tiny", "nano-pv", "base", "large"])
def test_the_dictionary_of_a_configuration_holds_json_values_without_null(preset):
    values = PRESETS[preset].to_dict()
    assert values == json.loads(json.dumps(values))
    assert "null" not in json.dumps(values)


TOML = """
preset = "mine"
num_layers = 3
map_classes = []

[image]
width_px = 704
height_px = 256
mean = [1, 2.5, 3]  # an integer is accepted for a float

[backbone]
block = "bottleneck"
depths = [3, 4, 6, 3]
deformable_stages = [3, 4]

[voxels]
size = [128, 128, 4]
"""


def test_a_configuration_can_be_written_in_toml_without_the_fields_that_have_a_default():
    assert DuoSpaceNetConfig.from_dict(tomllib.loads(TOML)) == DuoSpaceNetConfig(
        preset="mine",
        num_layers=3,
        map_classes=(),
        image=ImageConfig(704, 256, mean=(1, 2.5, 3)),
        backbone=ResNetConfig("bottleneck", (3, 4, 6, 3), deformable_stages=(3, 4)),
        voxels=VoxelGrid((128, 128, 4)),
    )


def test_the_removed_field_is_accepted_where_it_was_off():
    values = PRESETS["tiny"].to_dict()
    assert "relu_before_extra_level" not in values
    assert DuoSpaceNetConfig.from_dict(values | {"relu_before_extra_level": False}) == PRESETS["tiny"]


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (True, "relu_before_extra_level: expected false; got true. The last version with a ReLU .* is 0.2.0"),
        (0, "relu_before_extra_level is unknown"),
        (None, "relu_before_extra_level is unknown"),
    ],
)
def test_another_value_of_the_removed_field_is_refused(value, message):
    with pytest.raises(ValueError, match=message):
        DuoSpaceNetConfig.from_dict(PRESETS["tiny"].to_dict() | {"relu_before_extra_level": value})


def test_a_backbone_with_a_field_of_vovnet_is_a_vovnet():
    values = PRESETS["tiny"].to_dict() | {"backbone": {"stem": [8, 8, 8]}}
    assert DuoSpaceNetConfig.from_dict(values).backbone == VoVNetConfig(stem=(8, 8, 8))


# --- Values that do not fit together --------------------------------------------------------------------------------


def test_basic_blocks_cannot_be_deformable():
    with pytest.raises(ValueError, match=r"deformable_stages: expected an empty list with basic.*; got \(3, 4\)"):
        replace(PRESETS["nano"].backbone, deformable_stages=(3, 4))


def test_bev_fusion_needs_queries_that_attend_to_bev():
    with pytest.raises(ValueError, match=r'bev_temporal: expected "queries" because .* PV only; got "stacking"'):
        replace(PRESETS["tiny-pv"], bev_temporal="stacking")


def test_two_sets_of_queries_have_the_same_size():
    with pytest.raises(ValueError, match="num_queries: expected an even number for two sets of queries; got 31"):
        replace(PRESETS["tiny-unshared"], num_queries=31)


def test_the_map_segmentation_needs_a_grid_that_can_be_halved_twice():
    with pytest.raises(ValueError, match=r"voxels.size: expected X and Y divisible by 4 .*; got \(13, 8, 4\)"):
        replace(PRESETS["tiny"], voxels=VoxelGrid((13, 8, 4)))
    assert replace(PRESETS["tiny"], voxels=VoxelGrid((13, 8, 4)), map_classes=()).voxels.size == (13, 8, 4)


def test_the_channels_are_divided_among_the_heads():
    with pytest.raises(ValueError, match="channels: expected a multiple of num_heads, 4; got 30"):
        replace(PRESETS["tiny"], channels=30)


def test_a_voxel_grid_has_a_positive_extent():
    with pytest.raises(ValueError, match=r"upper_m: expected values above lower_m, .*; got \(0.0, -5.0, 5.0\)"):
        VoxelGrid((8, 8, 4), lower_m=(-5.0, -5.0, -3.0), upper_m=(0.0, -5.0, 5.0))


@pytest.mark.parametrize("field", ["classes", "map_classes"])
def test_class_names_are_different(field):
    with pytest.raises(ValueError, match=f"{field}: expected different names; got road, kerb, road"):
        replace(PRESETS["tiny"], **{field: ("road", "kerb", "road")})


def test_a_configuration_cannot_be_changed():
    with pytest.raises(FrozenInstanceError):
        SMALL.num_queries = 3
    with pytest.raises(FrozenInstanceError):
        SMALL.image.width_px = 3
