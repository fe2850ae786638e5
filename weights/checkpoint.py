"""Loading and saving checkpoints. A checkpoint is loaded completely or not at all."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from safetensors.torch import save
from torch import Tensor, nn

from ..model import DuoSpaceNet, DuoSpaceNetConfig
from ..model.config import ResNetConfig
from .checkpoint_error import CheckpointError
from .checkpoint_file import read_file
from .checkpoint_layout import recognise_layout
from .checkpoint_report import CheckpointReport
from .checkpoint_wrappers import unwrap
from .content_hash import with_content_hash
from .flat_checkpoint import UnwrapError
from .tensor_matching import match_tensors
from .trained_parts import model_parts, untrained_parts


class Checkpoint(NamedTuple):
    """The tensors of a file that match a model, by the model's names, and a report on all tensors."""

    tensors: dict[str, Tensor]
    report: CheckpointReport


def load_checkpoint(
    path: str | Path,
    model: nn.Module,
    allow_missing: Sequence[str] = (),
    ignore: Sequence[str] = (),
    weights_key: str | None = None,
) -> CheckpointReport:
    """Load the weights in `path` into `model`, in place, and return the report on every tensor.

    path: a safetensors file; a file of torch.save, which is read with `weights_only=True`; the index of a sharded
        checkpoint; or a folder with one of these. The tensor names may be this toolkit's, torchvision's of a ResNet,
        detectron2's of a VoVNet, or mmdetection3d's of an image backbone and neck. The usual wrappers of training
        code are removed.
    allow_missing: shell patterns of our names ("decoder.*"). Matching tensors may be missing; they keep their values.
    ignore: shell patterns of names in the file ("img_neck.*"). Matching tensors are treated as if they were not there.
    weights_key: the dotted keys of the weights ("ema.shadow"), if the file holds several copies.

    Every other tensor of the model must be in the file, finite and with the right shape. If the file holds a part of
    the model, such as the backbone, it must not hold tensors of this part that the model lacks. A foreign neck that
    does not fit is left aside if `allow_missing` includes the whole neck.

    Raises CheckpointError if the file cannot be read or does not match, and OSError if it does not exist or there is no
    permission to read it. The model is then unchanged.
    """
    tensors, report = read_checkpoint(path, model, allow_missing, ignore, weights_key)
    if not report.accepted:
        advice = "".join(f" {line}" for line in report.advice)
        raise CheckpointError(
            f"{path}: expected exactly the {report.num_expected} tensors of the model; got {report.verdict}.{advice}",
            report,
        )
    model.load_state_dict(tensors, strict=False)
    return report


def read_checkpoint(
    path: str | Path,
    model: nn.Module,
    allow_missing: Sequence[str] = (),
    ignore: Sequence[str] = (),
    weights_key: str | None = None,
) -> Checkpoint:
    """Compare the weights in `path` with `model`, without loading them. The model may be on the meta device.

    The arguments are those of `load_checkpoint`. Faults are listed in the report and raise no error.
    Raises CheckpointError if the file cannot be read or the choice between several copies is not clear, and OSError
    if it does not exist or there is no permission to read it.
    """
    path = Path(path)
    content, metadata = read_file(path)
    expected = model.state_dict()
    try:
        source = unwrap(content, expected, weights_key)
    except UnwrapError as error:
        raise CheckpointError(f"{path}: {error}.") from error
    if not source.tensors and not _is_empty(content):
        raise CheckpointError(
            f"{path}: expected a dictionary of named tensors, or one under 'state_dict' or 'model'; "
            f"got {_describe_content(content)}. Save model.state_dict()."
        )
    layout = recognise_layout(source.tensors, expected)
    report = match_tensors(source, layout, expected, allow_missing, ignore, metadata)
    if isinstance(model, DuoSpaceNet):
        report = report.with_notes(_notes_on_origin(report, model.config) + _notes_on_training(report, model.config))
    return Checkpoint({name: source.tensors[file_name] for name, file_name in report.matched.items()}, report)


def save_checkpoint(path: str | Path, model: nn.Module, metadata: Mapping[str, str] | None = None) -> None:
    """Write the weights of `model` to a safetensors file, which is overwritten if it exists.

    metadata: strings to store in the file, such as the configuration. A hash of the content is added.
    """
    tensors = {name: tensor.contiguous() for name, tensor in model.state_dict().items()}
    # Not save_file: it creates a file that only its owner may read (safetensors 0.8).
    Path(path).write_bytes(save(tensors, metadata=with_content_hash(tensors, metadata or {})))


def _notes_on_origin(report: CheckpointReport, config: DuoSpaceNetConfig) -> list[str]:
    """Notes on requirements for weights of other code bases that names and shapes cannot show."""
    notes = []
    if report.layout != "own" and any(name.startswith("image_encoder.backbone.") for name in report.matched):
        notes.append(
            "the backbone must have been trained with the preprocessing and settings of preset "
            f"{config.preset}, which cannot be checked: {_describe_backbone(config)}"
        )
    return notes


def _notes_on_training(report: CheckpointReport, config: DuoSpaceNetConfig) -> list[str]:
    """A note on the parts that the training of the weights left out."""
    untrained = [part for part in untrained_parts(report.metadata) if part in model_parts(config)]
    return [f"parts of the checkpoint that are not trained: {', '.join(untrained)}"] if untrained else []


def _describe_backbone(config: DuoSpaceNetConfig) -> str:
    image, backbone = config.image, config.backbone
    caffe_style = isinstance(backbone, ResNetConfig) and backbone.caffe_style
    stride = ", bottlenecks with the stride in the first 1x1 convolution" if caffe_style else ""
    return (
        f"{image.colour_order.upper()} images, mean {_format(image.mean)}, std {_format(image.std)}{stride}, "
        f"BatchNorm eps {backbone.batch_norm_eps:g}"
    )


def _is_empty(content: Any) -> bool:
    return isinstance(content, Mapping) and not content


def _describe_content(content: Any) -> str:
    """Describe content without named tensors, by its type or its first entry."""
    if not isinstance(content, Mapping):
        return type(content).__name__
    name, value = next(iter(content.items()))
    if not isinstance(name, str):
        return "a dictionary with names that are not strings"
    return f"a dictionary with {name!a}: {type(value).__name__}"


def _format(values: Sequence[float]) -> str:
    return "(" + ", ".join(f"{value:g}" for value in values) + ")"
