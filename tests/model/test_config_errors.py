"""A wrong configuration is refused with the name of the field, the allowed values and the value found."""

from datetime import date

import pytest

from duospacenet.model import PRESETS, DuoSpaceNetConfig

RESNET_FIELDS = "block, depths, width, caffe_style, batch_norm_eps, deformable_stages"
VOVNET_FIELDS = "stem, depths, widths, out_channels, num_convolutions, batch_norm_eps"
MISTAKES = {
    "unknown field": (
        lambda v: v.update(number_of_queries=3),
        "number_of_queries is unknown; expected only preset, im",
    ),
    "unknown field of a table": (
        lambda v: v["voxels"].update(x=3),
        "voxels.x is unknown; expected only size, lower_m,",
    ),
    "unknown field of a ResNet": (
        lambda v: v["backbone"].update(dcn=True),
        f"backbone.dcn is unknown; expected only {RESNET_FIELDS}",
    ),
    "unknown field of a VoVNet": (
        lambda v: v.update(backbone={"stem": [8, 8, 8], "dcn": True}),
        f"backbone.dcn is unknown; expected only {VOVNET_FIELDS}",
    ),
    "missing table": (lambda v: v.pop("image"), "image is missing"),
    "missing field": (lambda v: v.pop("preset"), "preset is missing"),
    "missing field of a table": (lambda v: v["voxels"].pop("size"), "voxels.size is missing"),
    "missing field of a ResNet": (lambda v: v["backbone"].pop("block"), "backbone.block is missing"),
    "too few values": (lambda v: v["backbone"].update(depths=[3, 4, 6]), "backbone.depths.3 is missing"),
    "number for a table": (lambda v: v.update(voxels=3), "voxels: expected a table of size, lower_m, upper_m; got 3"),
    "number for a backbone": (lambda v: v.update(backbone=3), f"backbone: expected a table of {RESNET_FIELDS}; got 3"),
    "string for a number": (lambda v: v.update(num_layers="2"), "num_layers: Input should be a valid integer; got '2'"),
    "float for an integer": (
        lambda v: v.update(num_layers=2.0),
        "num_layers: Input should be a valid integer; got 2.0",
    ),
    "boolean for an integer": (
        lambda v: v.update(num_layers=True),
        "num_layers: Input should be a valid integer; got True",
    ),
    "date for a number": (lambda v: v.update(num_layers=date(2020, 1, 2)), "num_layers: Input should be a valid int"),
    "zero": (lambda v: v.update(num_heads=0), "num_heads: Input should be greater than 0; got 0"),
    "absurdly many frames": (
        lambda v: v.update(num_frames=2**31),
        "num_frames: Input should be less than or equal to 256; got 2147483648",
    ),
    "absurdly many blocks": (
        lambda v: v["backbone"].update(depths=[3, 4, 2**31, 3]),
        "backbone.depths.2: Input should be less than or equal to 256; got 2147483648",
    ),
    "absurdly many channels": (
        lambda v: v.update(channels=2**31),
        "channels: Input should be less than or equal to 65536; got 2147483648",
    ),
    "zero deviation": (
        lambda v: v["image"].update(std=[1, 0, 1]),
        "image.std.1: Input should be greater than 0; got 0",
    ),
    "not a number": (
        lambda v: v["image"].update(mean=[1, 2, float("nan")]),
        "image.mean.2: Input should be a finite number; got nan",
    ),
    "none of the choices": (
        lambda v: v["image"].update(colour_order="grb"),
        "image.colour_order: Input should be 'rgb' or 'bgr'; got 'grb'",
    ),
    "null": (
        lambda v: v.update(queries=None),
        "queries: Input should be 'duo', 'shared_content', 'unshared', 'bev' or",
    ),
    "no class": (lambda v: v.update(classes=[]), "classes: Tuple should have at least 1 item"),
    "class without a name": (lambda v: v.update(classes=["car", ""]), "classes.1: String should have at least 1 char"),
    "map class that no graph output can be named after": (
        lambda v: v.update(map_classes=["lane.left"]),
        "map_classes.0: String should match pattern",
    ),
    "values that do not fit together": (
        lambda v: v.update(channels=30),
        "channels: expected a multiple of num_heads, ",
    ),
    "values of a table that do not fit together": (
        lambda v: v["backbone"].update(deformable_stages=[4]),
        "backbone.deformable_stages: expected an empty list with basic blocks; got (4,)",
    ),
    "two mistakes": (
        lambda v: v.update(num_heads=0, num_layers=0),
        "num_layers: Input should be greater than 0; got 0",
    ),
}


def message_after(spoil):
    values = PRESETS["tiny"].to_dict()
    spoil(values)
    with pytest.raises(ValueError) as error:
        DuoSpaceNetConfig.from_dict(values)
    return str(error.value)


@pytest.mark.parametrize("mistake", MISTAKES)
def test_the_message_starts_with_the_field_and_names_the_allowed_values(mistake):
    spoil, start = MISTAKES[mistake]
    assert message_after(spoil).startswith(start)


def test_the_message_counts_further_wrong_fields():
    assert message_after(MISTAKES["two mistakes"][0]).endswith("got 0 (wrong fields in all: 2)")
    assert "wrong fields" not in message_after(MISTAKES["zero"][0])


def test_values_that_are_not_a_table_are_refused():
    with pytest.raises(ValueError, match=r"the top level: expected a table of preset, image, .*; got 3"):
        DuoSpaceNetConfig.from_dict(3)


def test_long_values_are_cut():
    assert len(message_after(lambda values: values.update(num_layers="x" * 1000))) < 150
