"""Reading checkpoint files, without running any code that they contain."""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from safetensors import SafetensorError, safe_open

if TYPE_CHECKING:
    from .checkpoint_report import CheckpointReport

# The messages of torch 2.13 about a class or function that it refuses to unpickle. The group is the refused name.
_REFUSED_GLOBAL = re.compile(r"GLOBAL (\S+) (?:was not an allowed|whose module)")
_REFUSED_CLASS = re.compile(r"but got <class '([^']+)'>")
_NEVER_IN_WEIGHTS = re.compile(
    r"(builtins|os|posix|nt|sys|subprocess|shutil|socket|runpy|importlib|io|_?pickle|marshal)\b"
)


class CheckpointError(Exception):
    """A checkpoint that cannot be read or does not match the model. The message names the file and the tensor.

    report: the report on every tensor; None if the file cannot be read.
    """

    def __init__(self, message: str, report: "CheckpointReport | None" = None) -> None:
        super().__init__(message)
        self.report = report


def read_file(path: Path) -> tuple[Any, dict[str, str]]:
    """Read the content and the metadata of a checkpoint. Only safetensors files have metadata.

    A file that does not end in .safetensors is read as a pickle, always with `weights_only=True`.
    Raises CheckpointError if the file cannot be parsed, and OSError if it does not exist or there is no permission to
    read it.
    """
    _check_exists(path)
    return (_read_safetensors if path.suffix == ".safetensors" else _read_pickle)(path)


def read_metadata(path: Path) -> dict[str, str]:
    """Read the metadata of a checkpoint, without its tensors. It is empty for a file that is not safetensors.

    Raises CheckpointError if the file cannot be parsed, and OSError if it does not exist or there is no permission to
    read it.
    """
    _check_exists(path)
    if path.suffix != ".safetensors":
        return {}
    try:
        with safe_open(path, framework="pt") as file:
            return file.metadata() or {}
    except (SafetensorError, OSError, ValueError) as error:
        raise _unreadable(path, error) from error


def _check_exists(path: Path) -> None:
    """Raise FileNotFoundError if there is no file at `path`."""
    if not path.is_file():
        got = "a folder" if path.is_dir() else "no such file"
        raise FileNotFoundError(f"{path}: expected a checkpoint, .safetensors or .pth; got {got}.")


def _read_safetensors(path: Path) -> tuple[Any, dict[str, str]]:
    try:
        with safe_open(path, framework="pt") as file:
            return {name: file.get_tensor(name) for name in file.keys()}, file.metadata() or {}  # noqa: SIM118
    except (SafetensorError, OSError, ValueError) as error:
        raise _unreadable(path, error) from error


def _read_pickle(path: Path) -> tuple[Any, dict[str, str]]:
    try:
        return torch.load(path, map_location="cpu", weights_only=True), {}
    except Exception as error:  # depending on the damage: EOFError, UnpicklingError, RuntimeError, KeyError, ...
        raise _untrusted(path, error) or _unreadable(path, error) from error


def _untrusted(path: Path, error: Exception) -> CheckpointError | None:
    """The error for a pickle that contains more than tensors and plain values. None if it failed for another reason."""
    match = _REFUSED_GLOBAL.search(str(error)) or _REFUSED_CLASS.search(str(error))
    if match is None:
        return None
    name = match[1]
    if "." not in name or _NEVER_IN_WEIGHTS.match(name):  # torch gives the names of builtins without a module
        advice = "Weights never need it: do not open the file in any other way."
    else:
        advice = (
            "Do this only if you trust whoever made it: on the machine where it was made, save the tensors alone with "
            'torch.save(torch.load(FILE, weights_only=False)["state_dict"], "tensors.pth").'
        )
    return CheckpointError(
        f"{path}: expected a weights-only .pth, with tensors and plain values; got {path.stat().st_size} bytes that "
        f"ask for {name}, which could run code. {advice}"
    )


def _unreadable(path: Path, error: Exception) -> CheckpointError:
    size = path.stat().st_size
    with path.open("rb") as file:
        start = file.read(64)
    if size == 0:
        cause = "the file is empty; copy or download it again"
    elif start.startswith(b"version https://git-lfs"):
        cause = "the file is a git-lfs pointer; fetch the content with `git lfs pull`"
    elif start.lstrip().lower().startswith((b"<!doctype", b"<html")):
        cause = "the file is a web page; download the checkpoint itself"
    else:
        cause = f"the file is truncated, damaged or of another kind ({type(error).__name__}); copy or download it again"
    return CheckpointError(f"{path}: expected .safetensors or a weights-only .pth; got {size} bytes: {cause}.")
