"""Tests of the record of trained parts: after trainings of single tasks, and in weights files."""

from dataclasses import replace

import pytest
from safetensors.torch import save_file

from duospacenet.model import DuoSpaceNet, DuoSpaceNetConfig
from duospacenet.weights import save_checkpoint
from duospacenet.weights.checkpoint import load_checkpoint
from duospacenet.weights.provenance import record_checkpoint_weights
from duospacenet.weights.trained_parts import loaded_parts, model_parts, parts_metadata, trained_parts, untrained_parts
from tests.helpers.trainings import TINY

ALL = ("image_encoder", "lifter", "divergence_enhancement", "queries", "decoder", "segmentation")


def states(**changes):
    return dict.fromkeys(ALL, True) | changes


@pytest.mark.parametrize("queries", ["duo", "bev", "pv"])
@pytest.mark.parametrize("map_classes", [(), ("drivable_area",)])
def test_the_parts_are_the_children_with_parameters(queries, map_classes):
    config = DuoSpaceNetConfig.from_dict(TINY.to_dict() | {"queries": queries, "map_classes": list(map_classes)})
    children = [name for name, module in DuoSpaceNet(config).named_children() if any(True for _ in module.parameters())]
    assert sorted(model_parts(config)) == sorted(children)


def report_of(tmp_path, metadata, model, removed="", allowed=()):
    """The report on a file with the tensors of the model, except those whose names start with `removed`."""
    tensors = {name: t for name, t in model.state_dict().items() if not removed or not name.startswith(removed)}
    save_file({name: tensor.contiguous() for name, tensor in tensors.items()}, tmp_path / "w.safetensors", metadata)
    return load_checkpoint(tmp_path / "w.safetensors", model, allowed)


@pytest.mark.parametrize(
    ("metadata", "expected"),
    [
        ({"trained": "true"}, states()),
        ({"trained": "false"}, dict.fromkeys(ALL, False)),
        ({"trained": "unknown"}, dict.fromkeys(ALL, None)),
        ({}, dict.fromkeys(ALL, None)),
        ({"trained": "false", "untrained": "segmentation"}, states(segmentation=False)),
        ({"trained": "false", "untrained": "queries, decoder"}, states(queries=False, decoder=False)),
        ({"trained": "false", "untrained": "\x1b[31m, others"}, dict.fromkeys(ALL, False)),
    ],
)
def test_a_weights_file_says_which_parts_are_trained(tmp_path, tiny_model, metadata, expected):
    assert loaded_parts(TINY, report_of(tmp_path, metadata, tiny_model)) == expected


def test_a_part_with_missing_tensors_is_untrained(tmp_path, tiny_model):
    report = report_of(tmp_path, {"trained": "true"}, tiny_model, "decoder.layers.1", ["decoder.*"])
    assert loaded_parts(TINY, report) == states(decoder=False)


def test_without_a_checkpoint_no_part_is_trained():
    assert loaded_parts(TINY, None) == dict.fromkeys(ALL, False)


@pytest.mark.parametrize(
    ("start", "unchanged", "expected"),
    [
        ({}, (), {"trained": "true"}),
        ({}, ("segmentation",), {"trained": "false", "untrained": "segmentation"}),
        (states(), ("segmentation",), {"trained": "true"}),
        (states(segmentation=None), ("segmentation",), {"trained": "unknown"}),
        (states(queries=False, decoder=None), ("queries", "decoder"), {"trained": "false", "untrained": "queries"}),
        # First detection alone, then maps alone: everything is trained.
        (states(segmentation=False), ("queries", "decoder"), {"trained": "true"}),
    ],
)
def test_the_metadata_after_a_training_depends_on_what_it_started_from(start, unchanged, expected):
    metadata = parts_metadata(trained_parts(start, TINY, unchanged))
    assert metadata == expected
    assert untrained_parts(metadata) == [part for part in ALL if part in metadata.get("untrained", "")]


def test_a_partly_trained_checkpoint_is_recorded_as_not_trained_with_a_note(tmp_path, tiny_model):
    """The note is printed by export and inspect, and stored in the manifest."""
    path = tmp_path / "weights.safetensors"
    save_checkpoint(path, tiny_model, {"trained": "false", "untrained": "queries, decoder"})
    report = load_checkpoint(path, DuoSpaceNet(TINY))
    assert report.notes == ("parts of the checkpoint that are not trained: queries, decoder",)
    record = record_checkpoint_weights(tiny_model, path, report, 0)
    assert (record.trained, record.checkpoint.notes) == (False, report.notes)


def test_an_untrained_part_that_the_model_does_not_have_does_not_count(tmp_path, tiny_model):
    """A training of detection alone, loaded into a model without map segmentation."""
    path = tmp_path / "weights.safetensors"
    save_checkpoint(path, tiny_model, {"trained": "false", "untrained": "segmentation"})
    model = DuoSpaceNet(replace(TINY, map_classes=()))
    report = load_checkpoint(path, model, ignore=["segmentation.*"])
    assert report.notes == ()
    assert record_checkpoint_weights(model, path, report, 0).trained is True
