"""Loading and saving weights, strictly: every tensor of the model, of its shape, and finite, or a refusal by name."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from safetensors.torch import save
from torch import Tensor, nn

from ..model.config import DuoSpaceNetConfig, ResNetConfig
from ..model.duospacenet import DuoSpaceNet
from .checkpoint_file import CheckpointError, read_file
from .checkpoint_layout import is_state_dict, recognise, unwrap
from .checkpoint_report import CheckpointReport, survey


class Checkpoint(NamedTuple):
    """The tensors of a file that fit a model, by the model's names, and what became of the rest."""

    tensors: dict[str, Tensor]
    report: CheckpointReport


def load_checkpoint(path: str | Path, model: nn.Module, allow_missing: Sequence[str] = ()) -> CheckpointReport:
    """Load the weights in `path` into `model`, in place; returns what became of every tensor.

    Reads .safetensors, and .pth or .pt with `weights_only=True`, in our own layout, torchvision's of a ResNet,
    detectron2's of a VoVNet and mmdetection3d's of an image backbone and neck, in the wrappers that trainings put
    around them. Every tensor of the model must be in the file, with its shape, finite, and no other inside the parts
    that the file holds. What matches a pattern of `allow_missing` ("decoder.*") may be absent and stays as it is in
    `model`. Raises CheckpointError, and OSError for a file that is not there or may not be read; the model is as it
    was then.
    """
    tensors, report = read_checkpoint(path, model, allow_missing)
    if not report.accepted:
        raise CheckpointError(
            f"{path}: expected exactly the {report.num_expected} tensors of the model; got {report.verdict}.", report
        )
    model.load_state_dict(tensors, strict=False)
    return report


def read_checkpoint(path: str | Path, model: nn.Module, allow_missing: Sequence[str] = ()) -> Checkpoint:
    """Hold the weights in `path` against `model`, which may be on the meta device, and load nothing.

    A misfit is told in the report alone. Raises CheckpointError for a file that cannot be read, and OSError.
    """
    path = Path(path)
    content, metadata = read_file(path)
    source = unwrap(content)
    if not is_state_dict(source.tensors):
        raise CheckpointError(
            f"{path}: expected a dictionary of named tensors, or one under 'state_dict' or 'model'; "
            f"got {_what(source.tensors)}. Save model.state_dict()."
        )
    expected = model.state_dict()
    layout = recognise(source.tensors, expected)
    report = survey(source, layout, expected, allow_missing, metadata)
    if isinstance(model, DuoSpaceNet):
        report = report.with_notes(_origin_notes(report, model.config))
    return Checkpoint({our: source.tensors[name] for our, name in report.matched.items()}, report)


def save_checkpoint(path: str | Path, model: nn.Module, metadata: Mapping[str, str] | None = None) -> None:
    """Write the weights of `model` to `path` as safetensors."""
    tensors = {name: tensor.contiguous() for name, tensor in model.state_dict().items()}
    Path(path).write_bytes(save(tensors, metadata=dict(metadata or {})))  # save_file lets nobody else read its file


def _origin_notes(report: CheckpointReport, config: DuoSpaceNetConfig) -> list[str]:
    """What names and shapes cannot tell of weights that were trained elsewhere."""
    notes = []
    if report.layout != "own" and any(name.startswith("image_encoder.backbone.") for name in report.matched):
        image, backbone = config.image, config.backbone
        caffe_style = isinstance(backbone, ResNetConfig) and backbone.caffe_style
        stride = ", a bottleneck's stride in its first 1x1 convolution" if caffe_style else ""
        notes.append(
            f"the backbone must have been trained as preset {config.preset} runs it, which names and shapes cannot "
            f"tell: {image.colour_order.upper()} images less {_numbers(image.mean)} over {_numbers(image.std)}"
            f"{stride}, BatchNorm eps {backbone.batch_norm_eps:g}"
        )
    has_neck = report.layout == "mmdetection3d" and "image_encoder.neck.extra.weight" in report.matched
    if has_neck and config.relu_before_extra_level:
        notes.append(
            f"preset {config.preset} applies a ReLU before the neck's extra level; mmdetection's FPN has none there, "
            "even with relu_before_extra_convs=True. Set relu_before_extra_level to false in the configuration"
        )
    return notes


def _what(content: Any) -> str:
    """What stands where named tensors should, with the first name that has none."""
    if not isinstance(content, Mapping):
        return type(content).__name__
    odd = [f"{name!r}: {type(value).__name__}" for name, value in content.items() if not isinstance(value, Tensor)]
    return f"a dictionary with {odd[0]}" if odd else "a dictionary of names that are no text"


def _numbers(values: Sequence[float]) -> str:
    return "(" + ", ".join(f"{value:g}" for value in values) + ")"
