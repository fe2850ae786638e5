"""FCOS3D's checkpoint in mmdetection3d's model zoo, by its names: fcos3d_r101_caffe_fpn_gn-head_dcn_2x8_1x_nus-mono3d.

The names and shapes follow its configuration: mmdet's ResNet-101 and FPN, and mmdet3d's FCOSMono3DHead.
"""

from collections.abc import Iterator

import torch
from torch import Tensor

STAGES = ((3, 64, False), (4, 128, False), (23, 256, True), (3, 512, True))  # blocks, width, DCN
GROUP_CHANNELS = {"offset": 2, "depth": 1, "size": 3, "rot": 1, "velo": 2}


def fcos3d_checkpoint() -> dict[str, Tensor]:
    """The tensors of the file. They are zeros, and take the memory of one number each."""
    shapes = {**dict(_backbone()), **dict(_neck()), **dict(_head())}
    return {
        name: torch.zeros((), dtype=torch.int64 if name.endswith("num_batches_tracked") else torch.float32).expand(
            shape
        )
        for name, shape in shapes.items()
    }


Shapes = Iterator[tuple[str, tuple[int, ...]]]


def _backbone() -> Shapes:
    yield "backbone.conv1.weight", (64, 3, 7, 7)
    yield from _norm("backbone.bn1", 64)
    inputs = 64
    for stage, (depth, width, deformable) in enumerate(STAGES, start=1):
        for block in range(depth):
            start = f"backbone.layer{stage}.{block}"
            yield f"{start}.conv1.weight", (width, inputs, 1, 1)
            yield from _norm(f"{start}.bn1", width)
            yield f"{start}.conv2.weight", (width, width, 3, 3)
            if deformable:
                yield from _convolution(f"{start}.conv2.conv_offset", width, 27, 3)
            yield from _norm(f"{start}.bn2", width)
            yield f"{start}.conv3.weight", (4 * width, width, 1, 1)
            yield from _norm(f"{start}.bn3", 4 * width)
            if block == 0:
                yield f"{start}.downsample.0.weight", (4 * width, inputs, 1, 1)
                yield from _norm(f"{start}.downsample.1", 4 * width)
            inputs = 4 * width


def _neck() -> Shapes:
    for level, channels in enumerate((512, 1024, 2048)):
        yield from _convolution(f"neck.lateral_convs.{level}.conv", channels, 256, 1)
    for level in range(5):
        yield from _convolution(f"neck.fpn_convs.{level}.conv", 256, 256, 3)


def _head() -> Shapes:
    for branch in ("cls_convs", "reg_convs"):
        yield from _block(f"bbox_head.{branch}.0")
        yield from _block(f"bbox_head.{branch}.1")
        yield from _convolution(f"bbox_head.{branch}.1.conv.conv_offset", 256, 27, 3)
    for name, channels in (("cls", 10), ("dir_cls", 2), ("attr", 9)):
        yield from _block(f"bbox_head.conv_{name}_prev.0")
        yield from _convolution(f"bbox_head.conv_{name}", 256, channels, 1)
    yield from _block("bbox_head.conv_centerness_prev.0")
    yield from _convolution("bbox_head.conv_centerness", 64, 1, 1)
    for index, channels in enumerate(GROUP_CHANNELS.values()):
        yield from _block(f"bbox_head.conv_reg_prevs.{index}.0")
        yield from _convolution(f"bbox_head.conv_regs.{index}", 256, channels, 1)
    for level in range(5):
        yield from ((f"bbox_head.scales.{level}.{index}.scale", ()) for index in range(3))


def _block(name: str) -> Shapes:
    yield from _convolution(f"{name}.conv", 256, 256, 3)
    yield from ((f"{name}.gn.{leaf}", (256,)) for leaf in ("weight", "bias"))


def _convolution(name: str, inputs: int, outputs: int, size: int) -> Shapes:
    yield f"{name}.weight", (outputs, inputs, size, size)
    yield f"{name}.bias", (outputs,)


def _norm(name: str, channels: int) -> Shapes:
    yield from ((f"{name}.{leaf}", (channels,)) for leaf in ("weight", "bias", "running_mean", "running_var"))
    yield f"{name}.num_batches_tracked", ()
