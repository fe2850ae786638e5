"""A checkpoint file as it lies on the disk: what is in it, read without running any of it."""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from safetensors import SafetensorError, safe_open

if TYPE_CHECKING:
    from .checkpoint_report import CheckpointReport

# torch's own words for what it will not unpickle; the name is the class's or function's.
_REFUSED_GLOBAL = re.compile(r"GLOBAL (\S+) (?:was not an allowed|whose module)")
_REFUSED_CLASS = re.compile(r"but got <class '([^']+)'>")
_NO_BUSINESS_OF_WEIGHTS = re.compile(
    r"(builtins|os|posix|nt|sys|subprocess|shutil|socket|runpy|importlib|io|_?pickle|marshal)\b"
)


class CheckpointError(Exception):
    """A checkpoint that cannot be read, or does not fit the model. The message names the file and the tensor.

    report: of a file that can be read, what became of every tensor.
    """

    def __init__(self, message: str, report: "CheckpointReport | None" = None) -> None:
        super().__init__(message)
        self.report = report


def read_file(path: Path) -> tuple[Any, dict[str, str]]:
    """The content of a checkpoint, and its metadata (of a .pth: none).

    Reads .safetensors, and everything else as a pickle with `weights_only=True`; there is no other way in, whatever
    that refuses. Raises CheckpointError, and OSError for a file that is not there or may not be read.
    """
    if not path.is_file():
        got = "a folder" if path.is_dir() else "no such file"
        raise FileNotFoundError(f"{path}: expected a checkpoint, .safetensors or .pth; got {got}.")
    return (_read_safetensors if path.suffix == ".safetensors" else _read_pickle)(path)


def _read_safetensors(path: Path) -> tuple[Any, dict[str, str]]:
    try:
        with safe_open(path, framework="pt") as file:
            return {name: file.get_tensor(name) for name in file.keys()}, file.metadata() or {}  # noqa: SIM118
    except (SafetensorError, OSError, ValueError) as error:
        raise _unreadable(path, error) from error


def _read_pickle(path: Path) -> tuple[Any, dict[str, str]]:
    try:
        return torch.load(path, map_location="cpu", weights_only=True), {}
    except Exception as error:  # torch raises EOFError, UnpicklingError, RuntimeError, KeyError, ... by the damage
        raise _untrusted(path, error) or _unreadable(path, error) from error


def _untrusted(path: Path, error: Exception) -> CheckpointError | None:
    """The refusal of a pickle that asks for more than tensors and plain values; None for another failure."""
    found = _REFUSED_GLOBAL.search(str(error)) or _REFUSED_CLASS.search(str(error))
    if found is None:
        return None
    if "." not in found[1] or _NO_BUSINESS_OF_WEIGHTS.match(found[1]):  # torch names builtins by themselves
        advice = "No weights need that: do not open the file in any other way."
    else:
        advice = (
            "Only if you trust whoever made it: open it where it was made, and save the tensors alone, "
            'torch.save(torch.load(FILE, weights_only=False)["state_dict"], "tensors.pth").'
        )
    return CheckpointError(
        f"{path}: expected a weights-only .pth, of tensors and plain values; got {path.stat().st_size} bytes that ask "
        f"for {found[1]}, which would run code. {advice}"
    )


def _unreadable(path: Path, error: Exception) -> CheckpointError:
    size = path.stat().st_size
    with path.open("rb") as file:
        start = file.read(64)
    if size == 0:
        cause = "it is empty; copy or download it again"
    elif start.startswith(b"version https://git-lfs"):
        cause = "it is a git-lfs pointer; fetch the file itself with `git lfs pull`"
    elif start.lstrip().lower().startswith((b"<!doctype", b"<html")):
        cause = "it is a web page of another kind; download the file itself"
    else:
        cause = f"it is truncated, damaged, or of another kind ({type(error).__name__}); copy or download it again"
    return CheckpointError(f"{path}: expected .safetensors or a weights-only .pth; got {size} bytes: {cause}.")
