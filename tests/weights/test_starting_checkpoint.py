"""Tests of checkpoints that a training starts from, with the names of FCOS3D's."""

import copy

import pytest
import torch

from duospacenet.model import PRESETS, DuoSpaceNet
from duospacenet.weights import CheckpointError
from duospacenet.weights.starting_checkpoint import describe_start, load_start
from tests.helpers.checkpoints import altered, assert_filled, backbone_of, in_mmdetection3d_names, write
from tests.helpers.fcos3d import fcos3d_checkpoint


def fcos3d_of(tensors):
    """The backbone and the neck of a model as FCOS3D names them, with its fifth level and a head."""
    named = {name.removeprefix("img_"): tensor for name, tensor in in_mmdetection3d_names(tensors).items()}
    fifth = {f"neck.fpn_convs.4.conv.{leaf}": torch.zeros(3) for leaf in ("weight", "bias")}
    head = {"bbox_head.cls_convs.0.conv.weight": torch.zeros(3), "bbox_head.conv_cls.bias": torch.zeros(10)}
    return {"state_dict": named | fifth | head, "meta": {"epoch": 12}}


def test_fcos3d_fills_the_image_encoder_and_the_rest_keeps_its_values(tmp_path, tiny_model, other):
    tensors, before = tiny_model.state_dict(), copy.deepcopy(other.state_dict())
    report = load_start(write(tmp_path / "fcos3d.pth", fcos3d_of(tensors)), other)
    assert_filled(other, tensors, before, "image_encoder.")
    loaded, anew, unused = describe_start(report)
    counts = {
        part: sum(name.startswith(f"{part}.") for name in tensors) for part in ("image_encoder.backbone", "decoder")
    }
    assert loaded == (
        f"loaded: image_encoder.backbone ({counts['image_encoder.backbone']} tensors), image_encoder.neck (14 tensors)"
    )
    assert anew.startswith("starts anew: lifter (1 tensor), divergence_enhancement (")
    assert f"decoder ({counts['decoder']} tensors)" in anew
    assert unused == "not used: neck.fpn_convs.4.conv (2 tensors), bbox_head (2 tensors)"
    assert not any("--allow-missing" in note for note in report.notes)


@pytest.mark.filterwarnings("ignore:.*which is a no-op")  # the model is on the meta device
def test_the_published_names_of_fcos3d_fit_base(tmp_path):
    """ResNet-101 in caffe style with DCN in two stages, an FPN of five levels, and a head with GroupNorm."""
    file = fcos3d_checkpoint()
    with torch.device("meta"):
        base = DuoSpaceNet(PRESETS["base"])
    report = load_start(write(tmp_path / "fcos3d.pth", {"state_dict": file, "meta": {}}), base)
    loaded, _, unused = describe_start(report)
    assert loaded == "loaded: image_encoder.backbone (676 tensors), image_encoder.neck (14 tensors)"
    num_head = sum(name.startswith("bbox_head.") for name in file)
    assert unused == f"not used: neck.fpn_convs.4.conv (2 tensors), bbox_head ({num_head} tensors)"
    (note,) = report.notes
    assert "BGR images, mean (103.53, 116.28, 123.675), std (1, 1, 1), bottlenecks with the stride in the first" in note


def test_a_backbone_alone_is_enough_and_the_neck_starts_anew(tmp_path, tiny_model, other):
    tensors, before = tiny_model.state_dict(), copy.deepcopy(other.state_dict())
    report = load_start(write(tmp_path / "resnet.pth", backbone_of(tensors)), other)
    assert_filled(other, tensors, before, "image_encoder.backbone.")
    assert "starts anew: image_encoder.neck (14 tensors), lifter (1 tensor)" in describe_start(report)[1]


def test_a_neck_that_does_not_fit_starts_anew_as_a_whole(tmp_path, tiny_model, other):
    tensors, before = tiny_model.state_dict(), copy.deepcopy(other.state_dict())
    file = in_mmdetection3d_names(tensors) | {"img_neck.lateral_convs.3.conv.weight": torch.zeros(3)}
    report = load_start(write(tmp_path / "detector.pth", file), other)
    assert_filled(other, tensors, before, "image_encoder.backbone.")
    assert any("the neck in the file has other levels" in note for note in report.notes)


@pytest.mark.parametrize("lacking", ["layer2.0.conv1.weight", "bn1.running_var"])
def test_an_incomplete_backbone_is_refused(tmp_path, tiny_model, lacking):
    file = fcos3d_of(tiny_model.state_dict())
    del file["state_dict"][f"backbone.{lacking}"]
    with pytest.raises(CheckpointError, match=f"1 missing: image_encoder.backbone.{lacking}"):
        load_start(write(tmp_path / "fcos3d.pth", file), tiny_model)


def test_weights_of_this_toolkit_must_be_complete(tmp_path, tiny_model):
    tensors = altered(tiny_model.state_dict())
    complete = load_start(write(tmp_path / "weights.pth", tensors), copy.deepcopy(tiny_model))
    assert describe_start(complete) == []
    del tensors["lifter.reduction.weight"]
    with pytest.raises(CheckpointError, match=r"1 missing: lifter\.reduction\.weight"):
        load_start(write(tmp_path / "weights.pth", tensors), tiny_model)


def test_given_patterns_allow_more(tmp_path, tiny_model, other):
    tensors, before = tiny_model.state_dict(), copy.deepcopy(other.state_dict())
    file = fcos3d_of(tensors)
    del file["state_dict"]["backbone.layer2.0.conv1.weight"]
    report = load_start(write(tmp_path / "fcos3d.pth", file), other, ["*.layer2.0.conv1.*"])
    anew = "image_encoder.backbone.layer2.0.conv1.weight"
    assert "starts anew: image_encoder.backbone (1 tensor), lifter (1 tensor)" in describe_start(report)[1]
    assert torch.equal(other.state_dict()[anew], before[anew])
    assert_filled(other, tensors | {anew: before[anew]}, before, "image_encoder.")
