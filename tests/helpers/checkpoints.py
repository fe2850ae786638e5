"""Checkpoints for tests: files as training code writes them, and assertions on a model after loading."""

import contextlib
import copy
import re
from collections.abc import Sequence
from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file
from torch import Tensor, nn

from duospacenet.model.backbones.resnet import ResNet
from duospacenet.model.config import ResNetConfig
from duospacenet.weights import CheckpointError, CheckpointReport, load_checkpoint
from duospacenet.weights.checkpoint_layout import recognise_layout
from duospacenet.weights.checkpoint_wrappers import Unwrapped
from duospacenet.weights.tensor_matching import match_tensors
from tests.helpers.model_inputs import with_random_weights

SUFFIXES = [".pth", ".safetensors"]
FIRST = "conv1.weight"  # of `small_network`, with the shape (8, 3, 7, 7)
# Patterns of everything outside the backbone, and outside the image encoder.
BEYOND_THE_BACKBONE = ["image_encoder.neck.*", "[!i]*"]
BEYOND_THE_IMAGE_ENCODER = ["[!i]*"]
# Tensors of parts of an mmdetection3d detector that this toolkit does not have.
DETECTOR_HEADS = {
    "pts_bbox_head.cls_branches.0.0.weight": torch.zeros(3),
    "img_roi_head.bbox_head.weight": torch.zeros(3),
    "depth_branch.depth_layers.0.0.bias": torch.zeros(3),
}


def small_network(seed: int) -> ResNet:
    """A small ResNet with random weights."""
    return with_random_weights(ResNet(ResNetConfig("basic", (1, 1, 1, 1), width=8)), seed)


def write(path: Path, content) -> Path:
    """Save tensors, or any content as .pth, at `path`."""
    if path.suffix == ".safetensors":
        save_file({name: tensor.contiguous() for name, tensor in content.items()}, path)
    else:
        torch.save(content, path)
    return path


def prefixed(prefix: str, tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    """The same tensors with a prefix before each name."""
    return {prefix + name: tensor for name, tensor in tensors.items()}


def altered(tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    """The same names with other numbers, for a copy of the weights that must not be used."""
    return {name: tensor + 1 for name, tensor in tensors.items()}


def zeros(shape: Sequence[int], name: str) -> Tensor:
    """Zeros of any shape that take the memory of one number, with the dtype of the tensor `name`."""
    dtype = torch.int64 if name.endswith("num_batches_tracked") else torch.float32
    return torch.zeros((), dtype=dtype).expand(shape)


def report_on(file: dict[str, Tensor], expected: dict[str, Tensor], allow_missing: Sequence[str]) -> CheckpointReport:
    """The report on the tensors of a file, which is not written to disk."""
    return match_tensors(Unwrapped(file, (), (), ()), recognise_layout(file, expected), expected, allow_missing)


def assert_holds(model: nn.Module, tensors: dict[str, Tensor]) -> None:
    for name, tensor in model.state_dict().items():
        assert torch.equal(tensor, tensors[name]), name


def assert_filled(model: nn.Module, tensors: dict[str, Tensor], before: dict[str, Tensor], part: str) -> None:
    """Names that start with `part` have the file's tensors, the others their tensors from before."""
    for name, tensor in model.state_dict().items():
        expected = tensors if name.startswith(part) else before
        assert torch.equal(tensor, expected[name]), name


def assert_refused(
    path: Path, model: nn.Module, *words: str, error: type[Exception] = CheckpointError, name: bool = True
) -> str:
    """Loading fails with these words, and leaves the model unchanged. Returns the message.

    name: whether the message must contain the name of `path`, too.
    """
    before = copy.deepcopy(model.state_dict())
    with pytest.raises(error) as refusal:
        load_checkpoint(path, model)
    for word in (*([path.name] if name else []), *words):
        assert word in str(refusal.value)
    assert_holds(model, before)
    return str(refusal.value)


def refusal(path: Path, model: nn.Module) -> str:
    """The message of the error that loading raises."""
    with pytest.raises(CheckpointError) as error:
        load_checkpoint(path, model)
    return str(error.value)


def run_python_in(message: str, folder: Path) -> Path:
    """Run the Python code in a message, as a user would, and return the file that it writes to `folder`."""
    code = re.search(r"torch\.save\(.*\)", message)[0]
    with contextlib.chdir(folder):
        exec(f"import torch, numpy; {code}", {})
    return folder / "tensors.pth"


def backbone_of(tensors: dict[str, Tensor], prefix: str = "") -> dict[str, Tensor]:
    """The backbone of a DuoSpaceNet with another prefix, as torchvision, detectron2 and mmdetection3d name it."""
    ours = "image_encoder.backbone."
    return {prefix + name.removeprefix(ours): tensor for name, tensor in tensors.items() if name.startswith(ours)}


def in_mmdetection3d_names(tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    """The backbone and neck of a DuoSpaceNet with the names of an mmdetection3d detector. The rule is independent."""
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
