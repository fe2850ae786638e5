"""Checkpoints of torchvision, detectron2 and mmdetection3d are recognised and translated to our names."""

import copy
from pathlib import Path
from typing import get_args

import pytest
import torch

from duospacenet.jobs.checkpoint_summary import LAYOUT_DESCRIPTIONS
from duospacenet.model import PRESETS, DuoSpaceNet
from duospacenet.runtime.bundle.manifest import CheckpointRecord, LayoutName
from duospacenet.weights import load_checkpoint, read_checkpoint
from duospacenet.weights.checkpoint_layout import FCOS3D, MMDETECTION3D, OWN, TORCHVISION, VOVNETS
from tests.helpers.checkpoints import (
    BEYOND_THE_BACKBONE,
    BEYOND_THE_IMAGE_ENCODER,
    DETECTOR_HEADS,
    altered,
    assert_filled,
    assert_refused,
    backbone_of,
    in_mmdetection3d_names,
    prefixed,
    report_on,
    write,
    zeros,
)
from tests.helpers.vovnets import SMALL as VOVNET
from tests.helpers.vovnets import published_shapes

IMAGENET = Path(__file__).resolve().parents[2] / "../shared/data/resnet50_imagenet/resnet50_caffe_imagenet.safetensors"

# --- torchvision and mmdetection3d --------------------------------------------------------------------------------


def test_torchvisions_names_fill_the_backbone_and_ignore_the_classifier(tmp_path, tiny_model, other):
    tensors, before = tiny_model.state_dict(), copy.deepcopy(other.state_dict())
    resnet = backbone_of(tensors)
    assert "layer4.0.downsample.1.running_var" in resnet
    classifier = {"fc.weight": torch.zeros(1000, 64), "fc.bias": torch.zeros(1000)}
    report = load_checkpoint(write(tmp_path / "resnet.pth", resnet | classifier), other, BEYOND_THE_BACKBONE)
    assert report.layout == "torchvision"
    assert report.left_aside == ("fc.weight", "fc.bias")
    assert report.matched["image_encoder.backbone.conv1.weight"] == "conv1.weight"
    assert_filled(other, tensors, before, "image_encoder.backbone.")


@pytest.mark.parametrize("wrap", [lambda t: t, lambda t: {"state_dict": prefixed("module.", t), "meta": {}}])
def test_mmdetection3ds_names_fill_backbone_and_neck_and_ignore_the_heads(tmp_path, tiny_model, other, wrap):
    tensors, before = tiny_model.state_dict(), copy.deepcopy(other.state_dict())
    path = write(tmp_path / "detector.pth", wrap(in_mmdetection3d_names(tensors) | DETECTOR_HEADS))
    report = load_checkpoint(path, other, BEYOND_THE_IMAGE_ENCODER)
    assert report.layout == "mmdetection3d"
    assert [name.rpartition("module.")[2] for name in report.left_aside] == list(DETECTOR_HEADS)
    assert report.matched["image_encoder.neck.extra.bias"] == "img_neck.fpn_convs.3.conv.bias"
    assert report.matched["image_encoder.neck.output.2.weight"] == "img_neck.fpn_convs.2.conv.weight"
    assert_filled(other, tensors, before, "image_encoder.")


@pytest.mark.parametrize("prefix", ["", "img_", "module.", "model.img_", "encoders.camera."])
@pytest.mark.parametrize("num_levels", [4, 5, 6])
def test_fcos3ds_backbone_and_the_first_four_levels_of_its_neck_are_loaded(
    tmp_path, tiny_model, other, prefix, num_levels
):
    """FCOS3D's FPN has five levels. The fifth is computed from the fourth."""
    tensors, before = tiny_model.state_dict(), copy.deepcopy(other.state_dict())
    named = {name.replace("img_", prefix): tensor for name, tensor in in_mmdetection3d_names(tensors).items()}
    further = [f"{prefix}neck.fpn_convs.{i}.conv.{leaf}" for i in range(4, num_levels) for leaf in ("weight", "bias")]
    heads = [prefix.removesuffix("img_") + name for name in ("bbox_head.cls_convs.0.conv.weight", "bbox_head.scale")]
    unused = {name: torch.zeros(3) for name in (*further, *heads)}
    path = write(tmp_path / "fcos3d.pth", {"meta": {"epoch": 12}, "state_dict": named | unused})
    report = load_checkpoint(path, other, BEYOND_THE_IMAGE_ENCODER)
    assert report.layout == "mmdetection3d"
    assert len(report.matched) == len(named)
    assert len(report.left_aside) == len(unused)
    assert not [note for note in report.notes if "neck in the file has other levels" in note]
    assert_filled(other, tensors, before, "image_encoder.")


def test_fcos3ds_names_need_the_rest_of_the_model_to_be_allowed_to_be_missing(tmp_path, tiny_model):
    named = in_mmdetection3d_names(tiny_model.state_dict())
    path = write(tmp_path / "fcos3d.pth", {name.removeprefix("img_"): tensor for name, tensor in named.items()})
    assert_refused(path, tiny_model, "missing: lifter.reduction.weight", "--allow-missing 'lifter.*'")


def test_the_networks_of_a_lidar_detector_are_not_a_camera_backbone(tmp_path, tiny_model):
    """SECOND and its FPN have the same two words, and other networks behind them."""
    file = {"backbone.blocks.0.0.weight": torch.zeros(3), "neck.deblocks.0.0.weight": torch.zeros(3)}
    report = read_checkpoint(write(tmp_path / "second.pth", file), tiny_model, ["*"]).report
    assert (report.accepted, report.unexpected) == (False, tuple(file))


def test_the_levels_of_fcos3d_fit_base(base):
    """ResNet-101 with DCN, levels from C3, 256 channels: the paper's own start."""
    file = {"backbone." + name: zeros(tensor.shape, name) for name, tensor in backbone_of(base).items()}
    for index, channels in enumerate((512, 1024, 2048)):
        file[f"neck.lateral_convs.{index}.conv.weight"] = torch.zeros(256, channels, 1, 1)
        file[f"neck.lateral_convs.{index}.conv.bias"] = torch.zeros(256)
    for index in range(5):
        file[f"neck.fpn_convs.{index}.conv.weight"] = torch.zeros(256, 256, 3, 3)
        file[f"neck.fpn_convs.{index}.conv.bias"] = torch.zeros(256)
    report = report_on(file | {"bbox_head.conv_cls.weight": torch.zeros(3)}, base, BEYOND_THE_IMAGE_ENCODER)
    assert report.accepted
    assert len(report.matched) == 104 * 6 + len(OFFSETS) + 14
    assert report.left_aside == (
        *(f"neck.fpn_convs.4.conv.{n}" for n in ("weight", "bias")),
        "bbox_head.conv_cls.weight",
    )


WITHOUT_COUNTERPART = {
    "torchvision, a bias": (False, "layer1.0.conv1.bias"),
    "torchvision, another layer": (False, "layer5.0.conv1.weight"),
    "mmdetection3d, DCN offsets": (True, "img_backbone.layer3.0.conv2.conv_offset.weight"),
    "mmdetection3d, DCN offset bias": (True, "img_backbone.layer4.0.conv2.conv_offset.bias"),
    "mmdetection3d, a norm in the neck": (True, "img_neck.lateral_convs.0.bn.weight"),
    "mmdetection3d, a fourth lateral": (True, "img_neck.lateral_convs.3.conv.weight"),
    "mmdetection3d, another neck": (True, "img_neck.deblocks.0.0.weight"),
    "mmdetection3d, a norm in the fifth level": (True, "img_neck.fpn_convs.4.bn.weight"),
}


@pytest.mark.parametrize("case", WITHOUT_COUNTERPART)
def test_a_tensor_without_a_counterpart_in_a_known_part_is_refused_and_not_ignored(tmp_path, tiny_model, case):
    """Without it, the part would not compute what it was trained to compute."""
    from_mmdetection, extra = WITHOUT_COUNTERPART[case]
    named = in_mmdetection3d_names(tiny_model.state_dict())
    if not from_mmdetection:
        named = backbone_of(tiny_model.state_dict())
    path = write(tmp_path / "weights.pth", named | {extra: torch.zeros(3)})
    report = read_checkpoint(path, tiny_model, BEYOND_THE_IMAGE_ENCODER if "img_neck" in extra else ["*"]).report
    assert not report.accepted
    assert report.unexpected == (extra,)
    assert report.left_aside == ()


def test_a_file_with_our_names_must_not_have_names_of_another_layout(tmp_path, tiny_model):
    tensors = tiny_model.state_dict()
    path = write(tmp_path / "weights.pth", tensors | {"img_backbone.conv1.weight": torch.zeros(8, 3, 7, 7)})
    assert read_checkpoint(path, tiny_model).report.unexpected == ("img_backbone.conv1.weight",)


def test_a_mismatch_in_another_layout_is_reported_with_both_names(tmp_path, tiny_model):
    named = in_mmdetection3d_names(tiny_model.state_dict())
    path = write(tmp_path / "weights.pth", named | {"img_neck.fpn_convs.3.conv.bias": torch.zeros(7)})
    report = read_checkpoint(path, tiny_model, BEYOND_THE_IMAGE_ENCODER).report
    assert report.faults["mis-shaped"] == [
        "image_encoder.neck.extra.bias (img_neck.fpn_convs.3.conv.bias in the file, expected (32,), got (7,))"
    ]


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
    assert len([note for note in report.notes if "BGR images, mean (103.939, 116.779, 123.68)" in note]) == 1


# --- VoVNets of detectron2 and mmdetection3d ------------------------------------------------------------------------

# Tensors beside the network, by its prefix: in detectors of DD3D and vovnet-detectron2, in an FPN, in a classifier.
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


def tensors_beside(prefix):
    return {name: torch.zeros(3) for name in BESIDE_A_VOVNET[prefix]}


@pytest.mark.parametrize("prefix", BESIDE_A_VOVNET)
@pytest.mark.parametrize("wrap", [lambda t: t, lambda t: {"model": t, "iteration": 9, "optimizer": {"lr": 0.1}}])
def test_detectron2s_names_of_a_vovnet_fill_the_backbone(tmp_path, vovnet_model, other_vovnet, prefix, wrap):
    tensors, before = vovnet_model.state_dict(), copy.deepcopy(other_vovnet.state_dict())
    path = write(tmp_path / "vovnet.pth", wrap(backbone_of(tensors, prefix) | tensors_beside(prefix)))
    report = load_checkpoint(path, other_vovnet, BEYOND_THE_BACKBONE)
    assert report.layout == "vovnet"
    assert report.left_aside == BESIDE_A_VOVNET[prefix]
    name = "stage4.OSA4_3.concat.OSA4_3_concat/norm.running_var"
    assert report.matched[f"image_encoder.backbone.{name}"] == prefix + name
    assert_filled(other_vovnet, tensors, before, "image_encoder.backbone.")


def test_frozen_norms_without_counters_are_accepted(tmp_path, vovnet_model, other_vovnet):
    """detectron2's FrozenBatchNorm2d has the four numbers of a norm, as buffers."""
    named = backbone_of(vovnet_model.state_dict(), "backbone.bottom_up.")
    frozen = {name: tensor for name, tensor in named.items() if not name.endswith("num_batches_tracked")}
    assert len(named) - len(frozen) == 3 + sum(VOVNET.depths) * (VOVNET.num_convolutions + 1)
    report = load_checkpoint(write(tmp_path / "vovnet.pth", frozen), other_vovnet, BEYOND_THE_BACKBONE)
    assert len(report.matched) == len(frozen)


def test_mmdetection3ds_names_of_a_vovnet_fill_backbone_and_neck(tmp_path, vovnet_model, other_vovnet):
    tensors, before = vovnet_model.state_dict(), copy.deepcopy(other_vovnet.state_dict())
    named = in_mmdetection3d_names(tensors)
    assert "img_backbone.stage2.OSA2_1.ese.fc.weight" in named
    path = write(tmp_path / "detector.pth", {"state_dict": named | DETECTOR_HEADS, "meta": {}})
    report = load_checkpoint(path, other_vovnet, BEYOND_THE_IMAGE_ENCODER)
    assert (report.layout, report.left_aside) == ("mmdetection3d", tuple(DETECTOR_HEADS))
    assert_filled(other_vovnet, tensors, before, "image_encoder.")


@pytest.mark.parametrize("prefix", ["img_backbone.", *BESIDE_A_VOVNET])
def test_the_published_v2_99_fills_the_backbone_of_large(prefix):
    """The files of PETR and StreamPETR have it under img_backbone beside FCOS3D's bbox_head."""
    with torch.device("meta"):
        large = DuoSpaceNet(PRESETS["large"]).state_dict()
    shapes = published_shapes(PRESETS["large"].backbone)
    file = {prefix + name: zeros(shape, name) for name, shape in shapes.items()}
    report = report_on(file | {"bbox_head.cls_convs.0.conv.weight": torch.zeros(3)}, large, BEYOND_THE_BACKBONE)
    assert report.accepted
    assert report.layout == ("mmdetection3d" if prefix == "img_backbone." else "vovnet")
    assert len(report.matched) == 626
    assert report.left_aside == ("bbox_head.cls_convs.0.conv.weight",)


WITHOUT_COUNTERPART_IN_A_VOVNET = {
    "another module": "stage2.OSA2_2.ese.fc.bias",
    "another stage": "stage6.OSA6_1.ese.fc.bias",
    "another convolution": "stage3.OSA3_1.layers.2.OSA3_1_2/conv.weight",
    "depthwise": "stage3.OSA3_1.conv_reduction.OSA3_1_reduction_0/conv.weight",
    "a longer stem": "stem.stem_4/conv.weight",
    "a bias": "stem.stem_1/conv.bias",
}


@pytest.mark.parametrize("prefix", ["img_backbone.", *BESIDE_A_VOVNET])
@pytest.mark.parametrize("case", WITHOUT_COUNTERPART_IN_A_VOVNET)
def test_a_tensor_without_a_counterpart_in_a_vovnet_is_refused_and_not_ignored(vovnet_model, prefix, case):
    extra = prefix + WITHOUT_COUNTERPART_IN_A_VOVNET[case]
    tensors = vovnet_model.state_dict()
    report = report_on(backbone_of(tensors, prefix) | {extra: torch.zeros(3)}, tensors, ["*"])
    assert not report.accepted
    assert (report.unexpected, report.left_aside) == ((extra,), ())


def test_a_tensor_that_a_vovnet_lacks_is_missing(vovnet_model):
    tensors = vovnet_model.state_dict()
    named = backbone_of(tensors, "backbone.bottom_up.")
    del named["backbone.bottom_up.stage5.OSA5_1.ese.fc.weight"]
    report = report_on(named, tensors, BEYOND_THE_BACKBONE)
    assert report.missing == ("image_encoder.backbone.stage5.OSA5_1.ese.fc.weight",)
    assert not report.accepted


def test_the_network_of_a_detector_is_preferred_to_a_bare_network_in_the_same_file(vovnet_model):
    tensors = vovnet_model.state_dict()
    used, unused = backbone_of(tensors, "backbone.bottom_up."), backbone_of(altered(tensors), "")
    report = report_on(unused | used, tensors, BEYOND_THE_BACKBONE)
    assert set(report.matched.values()) == set(used)
    assert report.left_aside == tuple(unused)


@pytest.mark.parametrize("prefix", BESIDE_A_VOVNET)
def test_a_vovnet_does_not_fill_a_resnet_or_the_other_way_round(tmp_path, tiny_model, vovnet_model, prefix):
    path = write(tmp_path / "vovnet.pth", backbone_of(vovnet_model.state_dict(), prefix))
    assert_refused(path, tiny_model, f"unexpected: {prefix}stem.stem_1/conv.weight", "no tensor matches", "VoVNet")
    path = write(tmp_path / "resnet.pth", backbone_of(tiny_model.state_dict(), ""))
    assert_refused(path, vovnet_model, "unexpected: conv1.weight", "missing: image_encoder.backbone.stem.stem_1/conv")


# --- Deformable convolutions ------------------------------------------------------------------------------------------

# mmdetection's convolutions for the offsets and masks of DCNv2: two and one number for each of the nine points.
OFFSETS = {
    f"layer{stage}.{block}.conv2.conv_offset.{leaf}": (27, channels, 3, 3) if leaf == "weight" else (27,)
    for stage, depth, channels in ((3, 23, 256), (4, 3, 512))
    for block in range(depth)
    for leaf in ("weight", "bias")
}
BEYOND_A_PLAIN_RESNET = [*BEYOND_THE_BACKBONE, "image_encoder.backbone.*.conv_offset.*"]


@pytest.fixture(scope="module")
def base():
    """The tensors of the preset `base`, including its offsets."""
    with torch.device("meta"):
        offsets = {f"image_encoder.backbone.{name}": torch.zeros(shape) for name, shape in OFFSETS.items()}
        return DuoSpaceNet(PRESETS["base"]).state_dict() | offsets


def plain_resnet_of(expected):
    """The tensors of torchvision's ResNet-101, as zeros."""
    named = backbone_of(expected, "")
    return {name: zeros(tensor.shape, name) for name, tensor in named.items() if name not in OFFSETS}


@pytest.mark.parametrize("name", OFFSETS)
def test_mmdetections_offsets_keep_their_names(name):
    assert MMDETECTION3D.our_name(f"img_backbone.{name}") == f"image_encoder.backbone.{name}"


def test_mmdetection3ds_resnet_101_with_its_offsets_fills_the_backbone_of_base(base):
    named = plain_resnet_of(base) | {name: torch.zeros(()).expand(shape) for name, shape in OFFSETS.items()}
    report = report_on(prefixed("img_backbone.", named), base, BEYOND_THE_BACKBONE)
    assert report.accepted
    assert report.layout == "mmdetection3d"
    assert len(report.matched) == 104 * 6 + len(OFFSETS)  # convolutions, each with a norm of five tensors


def test_torchvisions_resnet_101_fills_base_only_where_the_offsets_may_be_missing(base):
    classifier = {"fc.weight": torch.zeros(1000, 2048), "fc.bias": torch.zeros(1000)}
    file = plain_resnet_of(base) | classifier
    refused = report_on(file, base, BEYOND_THE_BACKBONE)
    assert set(refused.missing) == {f"image_encoder.backbone.{name}" for name in OFFSETS}
    assert not refused.accepted
    accepted = report_on(file, base, BEYOND_A_PLAIN_RESNET)
    assert accepted.accepted
    assert accepted.layout == "torchvision"
    assert len(accepted.matched) == 104 * 6
    assert set(refused.missing) <= set(accepted.allowed_missing)
    assert accepted.left_aside == tuple(classifier)


# --- All layouts ----------------------------------------------------------------------------------------------------


def test_every_layout_is_one_that_the_manifest_can_record():
    layouts = {layout.name for layout in (OWN, MMDETECTION3D, FCOS3D, *VOVNETS, TORCHVISION)}
    assert layouts == set(get_args(LayoutName))
    assert CheckpointRecord.model_fields["layout"].annotation == LayoutName
    assert layouts == set(LAYOUT_DESCRIPTIONS)
