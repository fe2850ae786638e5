"""Checkpoints are loaded bit for bit, and notes name the requirements that cannot be checked."""

import copy
from dataclasses import replace

import pytest
import torch

from duospacenet.model import PRESETS, DuoSpaceNet
from duospacenet.weights import load_checkpoint, read_checkpoint, save_checkpoint
from tests.helpers.checkpoints import (
    BEYOND_THE_BACKBONE,
    SUFFIXES,
    assert_holds,
    backbone_of,
    write,
)
from tests.helpers.vovnets import SMALL as VOVNET


def test_loaded_weights_equal_the_saved_weights_bit_for_bit(tmp_path, tiny_model, other):
    save_checkpoint(tmp_path / "weights.safetensors", tiny_model, {"epoch": "24", "training": "none"})
    report = load_checkpoint(tmp_path / "weights.safetensors", other)
    assert report.metadata.items() >= {"epoch": "24", "training": "none"}.items()
    assert_holds(other, tiny_model.state_dict())
    assert report.matched == {name: name for name in tiny_model.state_dict()}
    assert (report.layout, report.wrappers, report.left_aside, report.notes) == ("own", (), (), ())


@pytest.mark.parametrize("suffix", [".pth", ".pt"])
def test_a_pickled_state_dict_has_no_metadata(tmp_path, model, weights, suffix):
    assert load_checkpoint(write(tmp_path / f"weights{suffix}", weights), model).metadata == {}
    assert_holds(model, weights)


def test_the_path_may_be_a_string(tmp_path, model, weights):
    load_checkpoint(str(write(tmp_path / "weights.pth", weights)), model)
    assert_holds(model, weights)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_half_precision_is_converted_to_the_models_precision(tmp_path, model, weights, suffix):
    halves = {name: tensor.half() if tensor.is_floating_point() else tensor for name, tensor in weights.items()}
    load_checkpoint(write(tmp_path / f"weights{suffix}", halves), model)
    assert_holds(model, {name: tensor.to(weights[name].dtype) for name, tensor in halves.items()})


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_batch_counters_may_be_missing(tmp_path, model, weights, suffix):
    without = {name: tensor for name, tensor in weights.items() if not name.endswith("num_batches_tracked")}
    assert len(without) < len(weights)
    load_checkpoint(write(tmp_path / f"weights{suffix}", without), model)
    assert_holds(model, weights)


def test_missing_tensors_that_match_a_pattern_keep_their_values(tmp_path, tiny_model, other):
    tensors, before = tiny_model.state_dict(), copy.deepcopy(other.state_dict())
    kept = {name: tensor for name, tensor in tensors.items() if not name.startswith(("decoder.", "queries."))}
    path = write(tmp_path / "weights.safetensors", kept)
    report = load_checkpoint(path, other, ["queries.pose", "decoder.*", "queries.c?nt*"])
    assert report.allowed_missing["queries.pose"] == "queries.pose"
    assert report.allowed_missing["queries.content"] == "queries.c?nt*"
    assert report.allowed_missing["decoder.layers.1.cross_attention.bev.norm.bias"] == "decoder.*"
    assert len(report.allowed_missing) == len(tensors) - len(kept)
    for name, tensor in other.state_dict().items():
        assert torch.equal(tensor, tensors[name] if name in kept else before[name]), name


# --- Notes --------------------------------------------------------------------------------------------------------


def test_a_note_gives_the_images_of_a_vovnet_without_a_stride(tmp_path, vovnet_model):
    large = DuoSpaceNet(replace(PRESETS["tiny"], preset="large", image=PRESETS["large"].image, backbone=VOVNET))
    path = write(tmp_path / "vovnet.pth", backbone_of(vovnet_model.state_dict(), ""))
    (note,) = read_checkpoint(path, large, BEYOND_THE_BACKBONE).report.notes
    assert "preset large" in note
    assert "BGR images, mean (103.53, 116.28, 123.675), std (57.375, 57.12, 58.395), BatchNorm eps 1e-05" in note
    assert "stride" not in note
