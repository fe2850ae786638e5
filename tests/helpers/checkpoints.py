"""What the tests of checkpoints share: files as trainings write them, and what a refusal must leave as it was."""

import copy
from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file
from torch import Tensor, nn

from duospacenet.weights import CheckpointError, load_checkpoint

SUFFIXES = [".pth", ".safetensors"]


def write(path: Path, content) -> Path:
    """Save tensors, or for a .pth anything, at `path`."""
    if path.suffix == ".safetensors":
        save_file({name: tensor.contiguous() for name, tensor in content.items()}, path)
    else:
        torch.save(content, path)
    return path


def assert_holds(model: nn.Module, tensors: dict[str, Tensor]) -> None:
    for name, tensor in model.state_dict().items():
        assert torch.equal(tensor, tensors[name]), name


def assert_refused(path: Path, model: nn.Module, *words: str, error: type[Exception] = CheckpointError) -> None:
    """Refused with these words and the file's name, and the model is as it was."""
    before = copy.deepcopy(model.state_dict())
    with pytest.raises(error) as refusal:
        load_checkpoint(path, model)
    for word in (path.name, *words):
        assert word in str(refusal.value)
    assert_holds(model, before)


def in_mmdetection3d_names(tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    """The backbone and neck of a DuoSpaceNet as an mmdetection3d detector names them, written out by hand."""
    neck = {
        "image_encoder.neck.lateral.0": "img_neck.lateral_convs.0.conv",
        "image_encoder.neck.lateral.1": "img_neck.lateral_convs.1.conv",
        "image_encoder.neck.lateral.2": "img_neck.lateral_convs.2.conv",
        "image_encoder.neck.output.0": "img_neck.fpn_convs.0.conv",
        "image_encoder.neck.output.1": "img_neck.fpn_convs.1.conv",
        "image_encoder.neck.output.2": "img_neck.fpn_convs.2.conv",
        "image_encoder.neck.extra": "img_neck.fpn_convs.3.conv",
    }
    named = {}
    for name, tensor in tensors.items():
        module, _, leaf = name.rpartition(".")
        if name.startswith("image_encoder.backbone."):
            named["img_backbone." + name.removeprefix("image_encoder.backbone.")] = tensor
        elif module in neck:
            named[f"{neck[module]}.{leaf}"] = tensor
    return named
