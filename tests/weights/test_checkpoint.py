"""Checkpoints that fit: back to the bit, from our own names and from others', and what the report says of them."""

import copy
from dataclasses import replace
from pathlib import Path
from typing import get_args

import pytest
import torch

from duospacenet.jobs.checkpoint_summary import LAYOUT_DESCRIPTIONS
from duospacenet.model import PRESETS, DuoSpaceNet, randomise
from duospacenet.model.backbones.resnet import ResNet
from duospacenet.model.config import ResNetConfig
from duospacenet.runtime.bundle.manifest import CheckpointRecord
from duospacenet.weights import CheckpointError, load_checkpoint, read_checkpoint, save_checkpoint
from duospacenet.weights.checkpoint_layout import MMDETECTION3D, LayoutName, Unwrapped, recognise
from duospacenet.weights.checkpoint_report import survey
from tests.helpers.checkpoints import SUFFIXES, assert_holds, assert_refused, in_mmdetection3d_names, write
from tests.helpers.model_inputs import drawn
from tests.helpers.vovnets import SMALL as VOVNET
from tests.helpers.vovnets import published_shapes

FIRST = "conv1.weight"  # (8, 3, 7, 7)
IMAGENET = Path(__file__).resolve().parents[2] / "../shared/data/resnet50_imagenet/resnet50_caffe_imagenet.safetensors"


@pytest.fixture(scope="module")
def weights():
    return network(seed=1).state_dict()


@pytest.fixture
def model():
    """A small part of the whole, with convolutions, norms and counters."""
    return network(seed=2)


@pytest.fixture
def other():
    """A tiny model that shares no number with `tiny_model`."""
    return randomise(DuoSpaceNet(PRESETS["tiny"]), seed=7)


@pytest.fixture(scope="module")
def vovnet_model():
    """A tiny model with a VoVNet."""
    return randomise(DuoSpaceNet(replace(PRESETS["tiny"], backbone=VOVNET)), seed=0)


@pytest.fixture
def other_vovnet():
    """The same with other numbers."""
    return randomise(DuoSpaceNet(replace(PRESETS["tiny"], backbone=VOVNET)), seed=7)


def network(seed):
    return drawn(ResNet(ResNetConfig("basic", (1, 1, 1, 1), width=8)), seed)


def altered(tensors):
    """The same names with other numbers, for the copy of the weights that must not be taken."""
    return {name: tensor + 1 for name, tensor in tensors.items()}


# --- Back to the bit ----------------------------------------------------------------------------------------------


def test_what_is_saved_comes_back_to_the_bit(tmp_path, tiny_model, other):
    save_checkpoint(tmp_path / "weights.safetensors", tiny_model, {"epoch": "24", "training": "none"})
    report = load_checkpoint(tmp_path / "weights.safetensors", other)
    assert report.metadata == {"epoch": "24", "training": "none"}
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
def test_half_precision_is_widened(tmp_path, model, weights, suffix):
    halves = {name: tensor.half() if tensor.is_floating_point() else tensor for name, tensor in weights.items()}
    load_checkpoint(write(tmp_path / f"weights{suffix}", halves), model)
    assert_holds(model, {name: tensor.to(weights[name].dtype) for name, tensor in halves.items()})


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_batch_counters_may_be_absent(tmp_path, model, weights, suffix):
    without = {name: tensor for name, tensor in weights.items() if not name.endswith("num_batches_tracked")}
    assert len(without) < len(weights)
    load_checkpoint(write(tmp_path / f"weights{suffix}", without), model)
    assert_holds(model, weights)


# --- What stands around the weights ----------------------------------------------------------------------------------

WRAPPED = {
    "state_dict": lambda w: {"state_dict": w, "epoch": 3},
    "model": lambda w: {"model": w, "optimizer": {"lr": 0.1}},
    "model_state_dict": lambda w: {"model_state_dict": w},
    "DataParallel": lambda w: prefixed("module.", w),
    "Lightning": lambda w: {"state_dict": prefixed("model.", w), "global_step": 9},
    "Lightning and DataParallel": lambda w: {"state_dict": prefixed("model.module.", w)},
    "torch.compile": lambda w: prefixed("_orig_mod.", w),
    "torch AveragedModel": lambda w: prefixed("module.", w) | {"n_averaged": torch.tensor(5)},
    "timm": lambda w: {"state_dict": altered(w), "state_dict_ema": w},
    "torchvision references": lambda w: {
        "model": altered(w),
        "model_ema": prefixed("module.", w) | {"n_averaged": torch.tensor(5)},
    },
    "RT-DETR": lambda w: {"model": altered(w), "ema": {"module": w, "updates": 7}},
    "mmengine": lambda w: {
        "state_dict": w,
        "ema_state_dict": prefixed("module.", altered(w)) | {"steps": torch.tensor(7)},
        "meta": {"epoch": 24},
    },
    "mmcv EMAHook": lambda w: {"state_dict": w | mmcv_doubles(w), "meta": {"epoch": 24}},
    "Lightning with a model beside its average": lambda w: {
        "state_dict": prefixed("model.", altered(w)) | prefixed("ema_model.module.", w)
    },
}
WRAPPERS = {
    "mmengine": ("state_dict",),
    "timm": ("state_dict_ema",),
    "torchvision references": ("model_ema", "module"),
    "RT-DETR": ("ema", "module"),
    "mmcv EMAHook": ("state_dict",),
    "Lightning with a model beside its average": ("state_dict", "ema_model", "module"),
}


def prefixed(prefix, tensors):
    return {prefix + name: tensor for name, tensor in tensors.items()}


def mmcv_doubles(tensors):
    """What mmcv's EMAHook registers: buffers named after the parameters alone."""
    statistics = ("running_mean", "running_var", "num_batches_tracked")
    parameters = {name: tensor for name, tensor in tensors.items() if not name.endswith(statistics)}
    return {"ema_" + name.replace(".", "_"): tensor for name, tensor in altered(parameters).items()}


@pytest.mark.parametrize("training", WRAPPED)
def test_the_weights_to_deploy_are_taken_out_of_what_a_training_saves(tmp_path, model, weights, training):
    path = write(tmp_path / "weights.pth", WRAPPED[training](weights))
    report = load_checkpoint(path, model)
    assert_holds(model, weights)
    assert report.wrappers == WRAPPERS.get(training, report.wrappers)


@pytest.mark.parametrize(
    ("training", "words", "aside"),
    [
        ("timm", "took state_dict_ema; left state_dict aside", "state_dict.conv1.weight"),
        (
            "mmengine",
            "took state_dict, which mmengine swaps with the average before it saves; left ema_state_dict aside",
            "ema_state_dict.module.conv1.weight",
        ),
        ("mmcv EMAHook", "the plain names were taken", "state_dict.ema_conv1_weight"),
        ("RT-DETR", "took ema; left model aside", "model.conv1.weight"),
        (
            "Lightning with a model beside its average",
            "took state_dict.ema_model; left state_dict.model aside",
            "state_dict.model.conv1.weight",
        ),
    ],
)
def test_the_report_says_which_copy_was_taken_and_which_was_not(tmp_path, model, weights, training, words, aside):
    report = load_checkpoint(write(tmp_path / "weights.pth", WRAPPED[training](weights)), model)
    assert len([note for note in report.notes if words in note]) == 1
    assert aside in report.left_aside
    num_doubles = len(mmcv_doubles(weights)) if training == "mmcv EMAHook" else len(weights)
    assert len([name for name in report.left_aside if not name.endswith("steps")]) == num_doubles


def test_a_prefix_that_not_every_tensor_has_is_no_wrapper(tmp_path, model, weights):
    path = write(tmp_path / "weights.pth", prefixed("module.", weights) | {"criterion.weight": torch.zeros(3)})
    assert_refused(path, model, "unexpected: module.conv1.weight", "missing: conv1.weight")


def test_an_ema_buffer_of_nothing_in_the_file_is_unexpected(tmp_path, model, weights):
    path = write(tmp_path / "weights.pth", weights | {"ema_layer9_weight": torch.zeros(3)})
    assert_refused(path, model, "1 unexpected: ema_layer9_weight")


def test_a_dictionary_that_holds_itself_is_refused(tmp_path, model):
    endless = {}
    endless |= {"model": endless, "state_dict": endless}
    assert_refused(write(tmp_path / "weights.pth", endless), model, "dictionary of named tensors")


# --- Names of others ----------------------------------------------------------------------------------------------

BEYOND_THE_BACKBONE = ["image_encoder.neck.*", "[!i]*"]
BEYOND_THE_IMAGE_ENCODER = ["[!i]*"]
HEADS = {
    "pts_bbox_head.cls_branches.0.0.weight": torch.zeros(3),
    "img_roi_head.bbox_head.weight": torch.zeros(3),
    "depth_branch.depth_layers.0.0.bias": torch.zeros(3),
}


def assert_filled(model, tensors, before, parts):
    """`parts` hold the file's tensors, the rest is as it was; no number is in both."""
    for name, tensor in model.state_dict().items():
        expected = tensors if name.startswith(parts) else before
        assert torch.equal(tensor, expected[name]), name


def test_torchvisions_names_fill_the_backbone_and_leave_the_classifier_aside(tmp_path, tiny_model, other):
    tensors, before = tiny_model.state_dict(), copy.deepcopy(other.state_dict())
    resnet = {
        name.removeprefix("image_encoder.backbone."): tensor
        for name, tensor in tensors.items()
        if name.startswith("image_encoder.backbone.")
    }
    assert "layer4.0.downsample.1.running_var" in resnet
    classifier = {"fc.weight": torch.zeros(1000, 64), "fc.bias": torch.zeros(1000)}
    report = load_checkpoint(write(tmp_path / "resnet.pth", resnet | classifier), other, BEYOND_THE_BACKBONE)
    assert report.layout == "torchvision"
    assert report.left_aside == ("fc.weight", "fc.bias")
    assert report.matched["image_encoder.backbone.conv1.weight"] == "conv1.weight"
    assert_filled(other, tensors, before, "image_encoder.backbone.")


@pytest.mark.parametrize("wrap", [lambda t: t, lambda t: {"state_dict": prefixed("module.", t), "meta": {}}])
def test_mmdetection3ds_names_fill_backbone_and_neck_and_leave_the_heads_aside(tmp_path, tiny_model, other, wrap):
    tensors, before = tiny_model.state_dict(), copy.deepcopy(other.state_dict())
    path = write(tmp_path / "detector.pth", wrap(in_mmdetection3d_names(tensors) | HEADS))
    report = load_checkpoint(path, other, BEYOND_THE_IMAGE_ENCODER)
    assert report.layout == "mmdetection3d"
    assert [name.rpartition("module.")[2] for name in report.left_aside] == list(HEADS)
    assert report.matched["image_encoder.neck.extra.bias"] == "img_neck.fpn_convs.3.conv.bias"
    assert report.matched["image_encoder.neck.output.2.weight"] == "img_neck.fpn_convs.2.conv.weight"
    assert_filled(other, tensors, before, "image_encoder.")


INSIDE = {
    "torchvision, a bias": (False, "layer1.0.conv1.bias"),
    "torchvision, another layer": (False, "layer5.0.conv1.weight"),
    "mmdetection3d, DCN offsets": (True, "img_backbone.layer3.0.conv2.conv_offset.weight"),
    "mmdetection3d, DCN offset bias": (True, "img_backbone.layer4.0.conv2.conv_offset.bias"),
    "mmdetection3d, a norm in the neck": (True, "img_neck.lateral_convs.0.bn.weight"),
    "mmdetection3d, a fifth level": (True, "img_neck.fpn_convs.4.conv.weight"),
    "mmdetection3d, a fourth lateral": (True, "img_neck.lateral_convs.3.conv.weight"),
    "mmdetection3d, another neck": (True, "img_neck.deblocks.0.0.weight"),
}


@pytest.mark.parametrize("case", INSIDE)
def test_what_has_no_place_inside_a_mapped_part_is_refused_and_not_left_aside(tmp_path, tiny_model, case):
    """The part would compute something else than it was trained to."""
    from_mmdetection, extra = INSIDE[case]
    named = in_mmdetection3d_names(tiny_model.state_dict())
    if not from_mmdetection:
        backbone = [name for name in named if name.startswith("img_backbone.")]
        named = {name.removeprefix("img_backbone."): named[name] for name in backbone}
    path = write(tmp_path / "weights.pth", named | {extra: torch.zeros(3)})
    report = read_checkpoint(path, tiny_model, ["*"]).report
    assert not report.accepted
    assert report.unexpected == (extra,)
    assert report.left_aside == ()


def test_names_of_ours_and_of_others_do_not_mix(tmp_path, tiny_model):
    tensors = tiny_model.state_dict()
    path = write(tmp_path / "weights.pth", tensors | {"img_backbone.conv1.weight": torch.zeros(8, 3, 7, 7)})
    assert read_checkpoint(path, tiny_model).report.unexpected == ("img_backbone.conv1.weight",)


def test_a_misfit_of_another_layout_is_told_by_both_names(tmp_path, tiny_model):
    named = in_mmdetection3d_names(tiny_model.state_dict())
    path = write(tmp_path / "weights.pth", named | {"img_neck.fpn_convs.3.conv.bias": torch.zeros(7)})
    report = read_checkpoint(path, tiny_model, ["*"]).report
    assert report.faults["mis-shaped"] == [
        "image_encoder.neck.extra.bias (img_neck.fpn_convs.3.conv.bias in the file, expected (32,), got (7,))"
    ]


@pytest.mark.parametrize(
    ("relu_before_extra_level", "file_has_neck", "num_notes"), [(True, True, 1), (True, False, 0), (False, True, 0)]
)
def test_a_note_says_that_the_neck_of_mmdetection_has_no_relu_where_the_model_has_one(
    tmp_path, tiny_model, relu_before_extra_level, file_has_neck, num_notes
):
    with torch.device("meta"):
        model = DuoSpaceNet(replace(PRESETS["tiny"], relu_before_extra_level=relu_before_extra_level))
    named = in_mmdetection3d_names(tiny_model.state_dict())
    named = {name: tensor for name, tensor in named.items() if file_has_neck or not name.startswith("img_neck.")}
    notes = read_checkpoint(write(tmp_path / "weights.pth", named), model, ["*"]).report.notes
    assert len([note for note in notes if "applies a ReLU before the neck's extra level" in note]) == num_notes


@pytest.mark.skipif(not IMAGENET.exists(), reason="the ImageNet weights are not beside the checkout")
def test_the_real_imagenet_weights_fill_the_backbone_of_small():
    with torch.device("meta"):
        small = DuoSpaceNet(PRESETS["small"])
    tensors, report = read_checkpoint(IMAGENET, small, BEYOND_THE_BACKBONE)
    backbone = [name for name in small.state_dict() if name.startswith("image_encoder.backbone.")]
    assert report.accepted
    assert report.layout == "torchvision"
    assert sorted(tensors) == sorted(backbone)
    assert len(tensors) == 318  # 53 convolutions, and as many norms of five tensors
    assert report.left_aside == ("fc.bias", "fc.weight")
    assert report.metadata["style"].startswith("caffe")
    assert len([note for note in report.notes if "BGR images less (103.939, 116.779, 123.68)" in note]) == 1


# --- A VoVNet, by its names in detectron2 and mmdetection3d ----------------------------------------------------------

# What stands beside the network, by what its names start with: DD3D's and vovnet-detectron2's whole detectors, an FPN,
# and a classifier.
BESIDE_A_VOVNET = {
    "backbone.bottom_up.": (
        "backbone.fpn_lateral3.weight",
        "backbone.top_block.p6.bias",
        "fcos2d_head.cls_logits.weight",
        "proposal_generator.rpn_head.conv.weight",
        "pixel_mean",
    ),
    "bottom_up.": ("fpn_lateral3.weight", "fpn_output5.bias"),
    "": ("classifier.weight", "fc.bias"),
}


def vovnet_of(tensors, start):
    """The VoVNet of a DuoSpaceNet as detectron2 names it."""
    ours = "image_encoder.backbone."
    return {start + name.removeprefix(ours): tensor for name, tensor in tensors.items() if name.startswith(ours)}


def beside(start):
    return {name: torch.zeros(3) for name in BESIDE_A_VOVNET[start]}


@pytest.mark.parametrize("start", BESIDE_A_VOVNET)
@pytest.mark.parametrize("wrap", [lambda t: t, lambda t: {"model": t, "iteration": 9, "optimizer": {"lr": 0.1}}])
def test_detectron2s_names_of_a_vovnet_fill_the_backbone(tmp_path, vovnet_model, other_vovnet, start, wrap):
    tensors, before = vovnet_model.state_dict(), copy.deepcopy(other_vovnet.state_dict())
    path = write(tmp_path / "vovnet.pth", wrap(vovnet_of(tensors, start) | beside(start)))
    report = load_checkpoint(path, other_vovnet, BEYOND_THE_BACKBONE)
    assert report.layout == "vovnet"
    assert report.left_aside == BESIDE_A_VOVNET[start]
    name = "stage4.OSA4_3.concat.OSA4_3_concat/norm.running_var"
    assert report.matched[f"image_encoder.backbone.{name}"] == start + name
    assert_filled(other_vovnet, tensors, before, "image_encoder.backbone.")


def test_frozen_norms_have_no_counters(tmp_path, vovnet_model, other_vovnet):
    """detectron2's FrozenBatchNorm2d has the four numbers of a norm, as buffers."""
    named = vovnet_of(vovnet_model.state_dict(), "backbone.bottom_up.")
    frozen = {name: tensor for name, tensor in named.items() if not name.endswith("num_batches_tracked")}
    assert len(named) - len(frozen) == 3 + sum(VOVNET.depths) * (VOVNET.num_convolutions + 1)
    report = load_checkpoint(write(tmp_path / "vovnet.pth", frozen), other_vovnet, BEYOND_THE_BACKBONE)
    assert len(report.matched) == len(frozen)


def test_mmdetection3ds_names_of_a_vovnet_fill_backbone_and_neck(tmp_path, vovnet_model, other_vovnet):
    tensors, before = vovnet_model.state_dict(), copy.deepcopy(other_vovnet.state_dict())
    named = in_mmdetection3d_names(tensors)
    assert "img_backbone.stage2.OSA2_1.ese.fc.weight" in named
    path = write(tmp_path / "detector.pth", {"state_dict": named | HEADS, "meta": {}})
    report = load_checkpoint(path, other_vovnet, BEYOND_THE_IMAGE_ENCODER)
    assert (report.layout, report.left_aside) == ("mmdetection3d", tuple(HEADS))
    assert_filled(other_vovnet, tensors, before, "image_encoder.")


@pytest.mark.parametrize("start", ["img_backbone.", *BESIDE_A_VOVNET])
def test_the_published_v2_99_fills_the_backbone_of_large(start):
    """The files of PETR and StreamPETR have it under img_backbone beside FCOS3D's bbox_head."""
    with torch.device("meta"):
        large = DuoSpaceNet(PRESETS["large"]).state_dict()
    shapes = published_shapes(PRESETS["large"].backbone)
    file = {start + name: _zeros(shape, name) for name, shape in shapes.items()}
    report = _survey(file | {"bbox_head.cls_convs.0.conv.weight": torch.zeros(3)}, large, BEYOND_THE_BACKBONE)
    assert report.accepted
    assert report.layout == ("mmdetection3d" if start == "img_backbone." else "vovnet")
    assert len(report.matched) == 626
    assert report.left_aside == ("bbox_head.cls_convs.0.conv.weight",)


INSIDE_A_VOVNET = {
    "another module": "stage2.OSA2_2.ese.fc.bias",
    "another stage": "stage6.OSA6_1.ese.fc.bias",
    "another convolution": "stage3.OSA3_1.layers.2.OSA3_1_2/conv.weight",
    "depthwise": "stage3.OSA3_1.conv_reduction.OSA3_1_reduction_0/conv.weight",
    "a longer stem": "stem.stem_4/conv.weight",
    "a bias": "stem.stem_1/conv.bias",
}


@pytest.mark.parametrize("start", ["img_backbone.", *BESIDE_A_VOVNET])
@pytest.mark.parametrize("case", INSIDE_A_VOVNET)
def test_what_has_no_place_inside_a_vovnet_is_refused_and_not_left_aside(vovnet_model, start, case):
    extra = start + INSIDE_A_VOVNET[case]
    tensors = vovnet_model.state_dict()
    report = _survey(vovnet_of(tensors, start) | {extra: torch.zeros(3)}, tensors, ["*"])
    assert not report.accepted
    assert (report.unexpected, report.left_aside) == ((extra,), ())


def test_what_a_vovnet_lacks_is_missing(vovnet_model):
    tensors = vovnet_model.state_dict()
    named = vovnet_of(tensors, "backbone.bottom_up.")
    del named["backbone.bottom_up.stage5.OSA5_1.ese.fc.weight"]
    report = _survey(named, tensors, BEYOND_THE_BACKBONE)
    assert report.missing == ("image_encoder.backbone.stage5.OSA5_1.ese.fc.weight",)
    assert not report.accepted


def test_of_a_detector_and_a_bare_network_in_one_file_the_detectors_is_taken(vovnet_model):
    tensors = vovnet_model.state_dict()
    taken, other = vovnet_of(tensors, "backbone.bottom_up."), vovnet_of(altered(tensors), "")
    report = _survey(other | taken, tensors, BEYOND_THE_BACKBONE)
    assert set(report.matched.values()) == set(taken)
    assert report.left_aside == tuple(other)


@pytest.mark.parametrize("start", BESIDE_A_VOVNET)
def test_a_vovnet_does_not_fill_a_resnet_nor_a_resnet_a_vovnet(tmp_path, tiny_model, vovnet_model, start):
    path = write(tmp_path / "vovnet.pth", vovnet_of(vovnet_model.state_dict(), start))
    assert_refused(path, tiny_model, f"unexpected: {start}stem.stem_1/conv.weight", "none that fits", "VoVNet")
    path = write(tmp_path / "resnet.pth", vovnet_of(tiny_model.state_dict(), ""))
    assert_refused(path, vovnet_model, "unexpected: conv1.weight", "missing: image_encoder.backbone.stem.stem_1/conv")


def test_a_vovnet_comes_with_a_note_on_its_images_and_none_on_a_stride(tmp_path, vovnet_model):
    large = DuoSpaceNet(replace(PRESETS["tiny"], preset="large", image=PRESETS["large"].image, backbone=VOVNET))
    path = write(tmp_path / "vovnet.pth", vovnet_of(vovnet_model.state_dict(), ""))
    (note,) = read_checkpoint(path, large, BEYOND_THE_BACKBONE).report.notes
    assert "preset large" in note
    assert "BGR images less (103.53, 116.28, 123.675) over (57.375, 57.12, 58.395), BatchNorm eps 1e-05" in note
    assert "stride" not in note


def _survey(file, expected, allow_missing):
    return survey(Unwrapped(file, (), (), ()), recognise(file, expected), expected, allow_missing)


def _zeros(shape, name):
    """Zeros of any shape, in the memory of one number."""
    return torch.zeros((), dtype=torch.int64 if name.endswith("num_batches_tracked") else torch.float32).expand(shape)


# --- Deformable convolutions ------------------------------------------------------------------------------------------

# mmdetection's offsets and masks of DCNv2: for each of nine places two and one.
OFFSETS = {
    f"layer{stage}.{block}.conv2.conv_offset.{leaf}": (27, channels, 3, 3) if leaf == "weight" else (27,)
    for stage, depth, channels in ((3, 23, 256), (4, 3, 512))
    for block in range(depth)
    for leaf in ("weight", "bias")
}
BEYOND_A_PLAIN_RESNET = [*BEYOND_THE_BACKBONE, "image_encoder.backbone.*.conv_offset.*"]


@pytest.fixture(scope="module")
def base():
    """What the preset `base` expects, with its offsets."""
    with torch.device("meta"):
        offsets = {f"image_encoder.backbone.{name}": torch.zeros(shape) for name, shape in OFFSETS.items()}
        return DuoSpaceNet(PRESETS["base"]).state_dict() | offsets


def plain_resnet_of(expected):
    """What torchvision's ResNet-101 holds, as zeros."""
    named = vovnet_of(expected, "")
    return {name: _zeros(tensor.shape, name) for name, tensor in named.items() if name not in OFFSETS}


@pytest.mark.parametrize("name", OFFSETS)
def test_mmdetections_offsets_keep_their_names(name):
    assert MMDETECTION3D.our_name(f"img_backbone.{name}") == f"image_encoder.backbone.{name}"


def test_mmdetection3ds_resnet_101_with_its_offsets_fills_the_backbone_of_base(base):
    named = plain_resnet_of(base) | {name: torch.zeros(()).expand(shape) for name, shape in OFFSETS.items()}
    report = _survey(prefixed("img_backbone.", named), base, BEYOND_THE_BACKBONE)
    assert report.accepted
    assert report.layout == "mmdetection3d"
    assert len(report.matched) == 104 * 6 + len(OFFSETS)  # convolutions, each with a norm of five tensors


def test_torchvisions_resnet_101_fills_base_only_where_the_offsets_may_be_missing(base):
    classifier = {"fc.weight": torch.zeros(1000, 2048), "fc.bias": torch.zeros(1000)}
    file = plain_resnet_of(base) | classifier
    refused = _survey(file, base, BEYOND_THE_BACKBONE)
    assert set(refused.missing) == {f"image_encoder.backbone.{name}" for name in OFFSETS}
    assert not refused.accepted
    accepted = _survey(file, base, BEYOND_A_PLAIN_RESNET)
    assert accepted.accepted
    assert accepted.layout == "torchvision"
    assert len(accepted.matched) == 104 * 6
    assert set(refused.missing) <= set(accepted.allowed_missing)
    assert accepted.left_aside == tuple(classifier)


# --- What may be missing ------------------------------------------------------------------------------------------


def test_what_matches_a_pattern_may_be_missing_and_stays_as_it_is(tmp_path, tiny_model, other):
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


def test_a_pattern_allows_what_is_missing_and_nothing_else(tmp_path, model, weights):
    path = write(tmp_path / "weights.pth", weights | {FIRST: torch.zeros(2), "other": torch.zeros(2)})
    report = read_checkpoint(path, model, ["*"]).report
    assert not report.accepted
    assert [len(tensors) for tensors in report.faults.values()] == [0, 1, 1, 0, 0]


def test_a_refusal_carries_the_report(tmp_path, model, weights):
    path = write(tmp_path / "weights.pth", weights | {"other": torch.zeros(2)})
    with pytest.raises(CheckpointError) as refusal:
        load_checkpoint(path, model)
    assert refusal.value.report == read_checkpoint(path, model).report
    assert refusal.value.report.unexpected == ("other",)


def test_a_pattern_that_does_nothing_is_told(tmp_path, model, weights):
    report = load_checkpoint(write(tmp_path / "weights.pth", weights), model, ["layer9.*"])
    assert report.notes == ("allowed to be missing, but nothing missing matches: layer9.*",)


@pytest.mark.parametrize("tensors", [{}, {"backbone.conv1.weight": torch.zeros(3)}], ids=["empty", "unknown names"])
def test_a_file_that_fills_nothing_is_refused_whatever_may_be_missing(tmp_path, model, tensors):
    report = read_checkpoint(write(tmp_path / "weights.pth", tensors), model, ["*"]).report
    assert not report.accepted
    for known in ("this toolkit's own names", "torchvision's ResNet", "detectron2's VoVNet", "mmdetection3d's img_"):
        assert known in report.verdict


def test_every_layout_has_a_place_in_the_manifest_and_words_on_the_command_line():
    layouts = get_args(LayoutName)
    assert layouts == get_args(CheckpointRecord.model_fields["layout"].annotation)
    assert set(layouts) == set(LAYOUT_DESCRIPTIONS)


# --- Tensors of kinds that a checkpoint of ours never holds ---------------------------------------------------------

ODD_TENSORS = {
    "float8": lambda t: t.to(torch.float8_e4m3fn),
    "sparse": lambda t: t.to_sparse(),
    "without data": lambda t: t.to("meta"),
    "endless, of one number": lambda t: torch.zeros(1).expand(2**45),
}


@pytest.mark.parametrize("change", ODD_TENSORS.values(), ids=ODD_TENSORS)
def test_a_tensor_of_an_odd_kind_is_refused_by_name(tmp_path, model, weights, change):
    assert_refused(write(tmp_path / "weights.pth", weights | {FIRST: change(weights[FIRST])}), model, FIRST)


def test_float8_in_safetensors_is_refused_by_name(tmp_path, model, weights):
    odd = weights | {FIRST: weights[FIRST].to(torch.float8_e4m3fn)}
    assert_refused(write(tmp_path / "weights.safetensors", odd), model, FIRST)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_double_that_overflows_the_models_float_is_refused_by_name(tmp_path, model, weights, suffix):
    doubles = torch.full(weights[FIRST].shape, 1e300, dtype=torch.float64)
    assert_refused(write(tmp_path / f"weights{suffix}", weights | {FIRST: doubles}), model, "not finite", FIRST)


@pytest.mark.parametrize("dtype", [torch.complex64, torch.bool, torch.int64, torch.uint8])
@pytest.mark.filterwarnings("ignore:Casting complex")
def test_numbers_that_are_not_floating_point_are_refused_by_name(tmp_path, model, weights, dtype):
    odd = weights | {FIRST: torch.ones(weights[FIRST].shape).to(dtype)}
    assert_refused(write(tmp_path / "weights.safetensors", odd), model, FIRST)
