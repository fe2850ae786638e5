"""Reading and writing weights, strictly: every tensor of the model, of its shape, and finite."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

_SHOWN = 5  # names in a message
_FLOATS = (torch.float16, torch.bfloat16, torch.float32, torch.float64)


class CheckpointError(Exception):
    """A checkpoint that cannot be read, or does not fit the model. The message names the file and the tensor."""


def load_checkpoint(path: str | Path, model: nn.Module) -> dict[str, str]:
    """Load the weights in `path` into `model`, in place; returns the file's metadata (of a .pth: none).

    Reads .safetensors, and .pth or .pt with `weights_only=True`, the tensors at the top or under "state_dict".
    Every tensor of the model must be in the file, with its shape, finite, and no other; only BatchNorm's
    `num_batches_tracked`, which inference never reads, may be absent. Raises CheckpointError, and OSError
    for a file that is not there or may not be read.
    """
    path = Path(path)
    if not path.is_file():
        got = "a folder" if path.is_dir() else "no such file"
        raise FileNotFoundError(f"{path}: expected a checkpoint, .safetensors or .pth; got {got}.")
    tensors, metadata = (_read_safetensors if path.suffix == ".safetensors" else _read_pickle)(path)
    _check_fit(path, tensors, model.state_dict())
    model.load_state_dict(tensors, strict=False)
    return metadata


def save_checkpoint(path: str | Path, model: nn.Module, metadata: Mapping[str, str] | None = None) -> None:
    """Write the weights of `model` to `path` as safetensors."""
    tensors = {name: tensor.contiguous() for name, tensor in model.state_dict().items()}
    save_file(tensors, str(path), metadata=dict(metadata or {}))


def _read_safetensors(path: Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    try:
        with safe_open(path, framework="pt") as file:
            return {name: file.get_tensor(name) for name in file.keys()}, file.metadata() or {}  # noqa: SIM118
    except (SafetensorError, OSError, ValueError) as error:
        raise _unreadable(path, error) from error


def _read_pickle(path: Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises EOFError, UnpicklingError, RuntimeError, KeyError, ... by the damage
        raise _unreadable(path, error) from error
    content = content.get("state_dict", content) if isinstance(content, dict) else content
    if not _is_state_dict(content):
        raise CheckpointError(
            f"{path}: expected a dictionary of named tensors, or one under 'state_dict'; "
            f"got {type(content).__name__}. Save model.state_dict()."
        )
    return dict(content), {}


def _is_state_dict(content: Any) -> bool:
    return isinstance(content, dict) and all(
        isinstance(name, str) and isinstance(value, Tensor) for name, value in content.items()
    )


def _unreadable(path: Path, error: Exception) -> CheckpointError:
    size = path.stat().st_size
    with path.open("rb") as file:
        start = file.read(64)
    if size == 0:
        cause = "it is empty"
    elif start.startswith(b"version https://git-lfs"):
        cause = "it is a git-lfs pointer; fetch the file itself with `git lfs pull`"
    else:
        cause = f"it is truncated, damaged, or of another kind ({type(error).__name__})"
    return CheckpointError(f"{path}: expected .safetensors or a weights-only .pth; got {size} bytes: {cause}.")


def _check_fit(path: Path, tensors: Mapping[str, Tensor], expected: Mapping[str, Tensor]) -> None:
    """Names, then kinds, and numbers last: only a tensor that fits is small enough, and of a kind, to look into."""
    missing = [name for name in expected if name not in tensors and not name.endswith("num_batches_tracked")]
    unexpected = [name for name in tensors if name not in expected]
    known = {name: (tensor, expected[name]) for name, tensor in tensors.items() if name in expected}
    misshapen = [
        f"{name} (expected {tuple(want.shape)}, got {tuple(tensor.shape)})"
        for name, (tensor, want) in known.items()
        if tensor.shape != want.shape
    ]
    mistyped = [
        f"{name} (expected {want.dtype}, got {tensor.dtype}, {tensor.layout}, on {tensor.device})"
        for name, (tensor, want) in known.items()
        if not _is_plain(tensor, want)
    ]
    fitting = [name for name, (tensor, want) in known.items() if tensor.shape == want.shape and _is_plain(tensor, want)]
    # Looked at in the model's own type, in which a large number may be infinite.
    broken = [name for name in fitting if not bool(tensors[name].to(expected[name].dtype).isfinite().all())]
    faults = {
        "missing": missing,
        "unexpected": unexpected,
        "mis-shaped": misshapen,
        "mis-typed": mistyped,
        "not finite": broken,
    }
    found = [f"{len(names)} {fault}: {_shorten(names)}" for fault, names in faults.items() if names]
    if found:
        raise CheckpointError(
            f"{path}: expected exactly the {len(expected)} tensors of the model; got " + "; ".join(found) + "."
        )


def _is_plain(tensor: Tensor, expected: Tensor) -> bool:
    """Whether the tensor holds plain numbers of the expected kind: any usual float for a float."""
    dtypes = _FLOATS if expected.is_floating_point() else (expected.dtype,)
    return tensor.dtype in dtypes and tensor.layout == torch.strided and tensor.device.type == "cpu"


def _shorten(names: list[str]) -> str:
    more = f", and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    return ", ".join(names[:_SHOWN]) + more
