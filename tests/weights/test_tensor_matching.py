"""Parts of a file that do not fit are left out by explicit patterns, and are recorded."""

import copy
import shlex

import pytest
import torch

from duospacenet.weights import load_checkpoint, read_checkpoint
from tests.helpers.checkpoints import (
    BEYOND_THE_IMAGE_ENCODER,
    DETECTOR_HEADS,
    assert_filled,
    assert_refused,
    in_mmdetection3d_names,
    write,
)

# The neck of StreamPETR and BEVDet: two inputs, one output.
TWO_INPUTS = {
    "img_neck.lateral_convs.0.conv.weight": torch.ones(32, 64, 1, 1),
    "img_neck.lateral_convs.0.conv.bias": torch.ones(32),
    "img_neck.lateral_convs.1.conv.weight": torch.ones(32, 128, 1, 1),
    "img_neck.lateral_convs.1.conv.bias": torch.ones(32),
    "img_neck.fpn_convs.0.conv.weight": torch.ones(32, 32, 3, 3),
    "img_neck.fpn_convs.0.conv.bias": torch.ones(32),
}
OTHER_NECKS = {
    "two inputs": lambda neck: TWO_INPUTS,
    "a fourth input": lambda neck: neck | {"img_neck.lateral_convs.3.conv.weight": torch.ones(3)},
    "norms": lambda neck: neck | {"img_neck.lateral_convs.0.bn.weight": torch.ones(3)},
    "another kind": lambda neck: {"img_neck.deblocks.0.0.weight": torch.ones(3)},
    "other channels": lambda neck: {name: torch.ones(7) for name in neck},
}


@pytest.fixture(scope="module")
def detector(tiny_model):
    """The backbone and the neck of a detector, apart."""
    named = in_mmdetection3d_names(tiny_model.state_dict())
    neck = {name: tensor for name, tensor in named.items() if name.startswith("img_neck.")}
    return {name: named[name] for name in named if name not in neck}, neck


def write_detector(tmp_path, detector, kind):
    backbone, neck = detector
    return write(tmp_path / "detector.pth", {"state_dict": backbone | OTHER_NECKS[kind](neck) | DETECTOR_HEADS})


@pytest.mark.parametrize("kind", OTHER_NECKS)
def test_a_neck_that_does_not_fit_is_left_out_by_a_pattern(tmp_path, tiny_model, other, detector, kind):
    before = copy.deepcopy(other.state_dict())
    path = write_detector(tmp_path, detector, kind)
    neck = OTHER_NECKS[kind](detector[1])
    report = load_checkpoint(path, other, [*BEYOND_THE_IMAGE_ENCODER, "image_encoder.neck.*"], ["img_neck.*"])
    assert report.ignored == dict.fromkeys(neck, "img_neck.*")
    assert report.allowed_missing["image_encoder.neck.extra.bias"] == "image_encoder.neck.*"
    assert report.left_aside == tuple(DETECTOR_HEADS)
    assert_filled(other, tiny_model.state_dict(), before, "image_encoder.backbone.")


@pytest.mark.parametrize("kind", OTHER_NECKS)
def test_a_neck_that_does_not_fit_is_left_aside_as_a_whole_if_the_whole_neck_may_be_missing(
    tmp_path, tiny_model, other, detector, kind
):
    before = copy.deepcopy(other.state_dict())
    path = write_detector(tmp_path, detector, kind)
    report = load_checkpoint(path, other, ["*"])
    assert set(report.left_aside) == set(OTHER_NECKS[kind](detector[1])) | set(DETECTOR_HEADS)
    assert len([note for note in report.notes if "the neck in the file has other levels or inputs" in note]) == 1
    assert_filled(other, tiny_model.state_dict(), before, "image_encoder.backbone.")


@pytest.mark.parametrize("kind", OTHER_NECKS)
@pytest.mark.parametrize("allowed", [BEYOND_THE_IMAGE_ENCODER, ["[!i]*", "image_encoder.neck.lateral.*"]])
def test_a_neck_that_does_not_fit_is_refused_unless_the_whole_neck_may_be_missing(
    tmp_path, tiny_model, detector, kind, allowed
):
    report = read_checkpoint(write_detector(tmp_path, detector, kind), tiny_model, allowed).report
    assert not report.accepted
    assert "--ignore 'img_neck.*'" in " ".join(report.advice)


def test_a_neck_that_fits_is_loaded_even_if_it_may_be_missing(tmp_path, tiny_model, other, detector):
    before = copy.deepcopy(other.state_dict())
    load_checkpoint(write(tmp_path / "detector.pth", detector[0] | detector[1]), other, ["*"])
    assert_filled(other, tiny_model.state_dict(), before, "image_encoder.")


@pytest.mark.parametrize("change", [lambda t: t * torch.nan, lambda t: t.to(torch.int64)])
def test_a_neck_that_fits_and_is_damaged_is_refused(tmp_path, tiny_model, detector, change):
    backbone, neck = detector
    name = "img_neck.fpn_convs.0.conv.weight"
    path = write(tmp_path / "detector.pth", backbone | neck | {name: change(neck[name])})
    assert not read_checkpoint(path, tiny_model, ["*"]).report.accepted


@pytest.mark.parametrize(
    "edit",
    [
        lambda b: b | {"img_backbone.layer1.0.conv1.weight": torch.ones(3)},
        lambda b: b | {"img_backbone.layer3.0.conv2.conv_offset.weight": torch.ones(3)},
    ],
)
def test_a_backbone_that_does_not_fit_is_never_left_aside_without_ignore(tmp_path, tiny_model, detector, edit):
    path = write(tmp_path / "detector.pth", edit(detector[0]))
    assert not read_checkpoint(path, tiny_model, ["*"]).report.accepted


def test_a_head_of_our_own_with_other_classes_is_left_out_by_a_pattern(tmp_path, tiny_model, other):
    tensors, before = tiny_model.state_dict(), copy.deepcopy(other.state_dict())
    heads = [name for name in tensors if ".heads.classes." in name]
    file = tensors | {name: torch.zeros(3) for name in heads} | {"loss_weights": torch.zeros(3)}
    patterns = ["decoder.layers.*.heads.classes.*", "loss_weights"]
    report = load_checkpoint(write(tmp_path / "w.pth", file), other, ["decoder.layers.*.heads.classes.*"], patterns)
    assert set(report.ignored) == {*heads, "loss_weights"}
    for name, tensor in other.state_dict().items():
        assert torch.equal(tensor, before[name] if name in heads else tensors[name]), name


def test_what_is_left_out_must_be_allowed_to_be_missing(tmp_path, tiny_model):
    path = write(tmp_path / "w.pth", tiny_model.state_dict())
    report = read_checkpoint(path, tiny_model, [], ["queries.*"]).report
    assert not report.accepted
    assert (
        set(report.missing) == set(report.ignored) == {name for name in tiny_model.state_dict() if "queries." in name}
    )


def test_a_pattern_without_a_tensor_in_the_file_is_noted(tmp_path, model, weights):
    report = load_checkpoint(write(tmp_path / "w.pth", weights), model, ignore=["img_neck.*"])
    assert report.notes == ("the --ignore pattern img_neck.* matches no tensor of the file",)


def test_following_the_advice_step_by_step_ends_with_loaded_weights(tmp_path, tiny_model, other, detector):
    path = write_detector(tmp_path, detector, "two inputs")
    options = {"--allow-missing": [], "--ignore": []}
    for _ in range(20):
        report = read_checkpoint(path, tiny_model, options["--allow-missing"], options["--ignore"]).report
        if report.accepted:
            break
        assert report.advice
        for line in report.advice:
            option, pattern = line.rpartition(": ")[2].removesuffix(".").split(" ")
            options[option].append(pattern.strip("'"))
    load_checkpoint(path, other, options["--allow-missing"], options["--ignore"])


def test_the_advice_leaves_no_loaded_tensor_of_ours_out(tmp_path, tiny_model):
    path = write(tmp_path / "w.pth", tiny_model.state_dict() | {"decoder.extra": torch.zeros(3)})
    assert read_checkpoint(path, tiny_model).report.advice == (
        "Tensors of the file can be left out: --ignore 'decoder.extra'.",
    )


@pytest.mark.parametrize("name", ["heads[0].weight", "it's.weight", "a?b", "two words.weight"])
def test_the_advice_works_for_names_that_are_special_in_a_shell_or_a_pattern(tmp_path, model, weights, name):
    path = write(tmp_path / "w.pth", weights | {name: torch.zeros(3)})
    (line,) = read_checkpoint(path, model).report.advice
    (pattern,) = shlex.split(line.partition("--ignore ")[2].removesuffix("."))
    assert load_checkpoint(path, model, ignore=[pattern]).ignored == {name: pattern}


def test_a_refusal_gives_the_advice(tmp_path, model, weights):
    path = write(tmp_path / "w.pth", weights | {"depth_head.weight": torch.zeros(3)})
    assert_refused(path, model, "Tensors of the file can be left out: --ignore 'depth_head.*'.")
    load_checkpoint(path, model, ignore=["depth_head.*"])
