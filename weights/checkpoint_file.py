"""Reading checkpoint files, without running any code that they contain."""

import re
import warnings
import zipfile
from contextlib import suppress
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open

from ..runtime.files import check_regular_file, path_for_native_code
from .checkpoint_error import CheckpointError
from .checkpoint_folder import find_checkpoint
from .checkpoint_format import checkpoint_format, describe_other_kind, is_recognised
from .content_hash import HASH_KEY, is_intact
from .conversion_code import code_to_save_tensors
from .pickle_outline import read_outline
from .sharded_checkpoint import check_not_a_shard, find_shards, read_sharded

_MAX_FILE_BYTES = 20 * 10**9  # V2-99 and its optimizer have 1 GB
_MAX_UNPACKED_BYTES = 10**9  # of a small archive; a larger one may unpack to four times its size

# The messages of torch 2.13 about a class or function that it refuses to unpickle. The group is the refused name.
_REFUSED_GLOBAL = re.compile(r"GLOBAL (\S+) (?:was not an allowed|whose module)")
_REFUSED_CLASS = re.compile(r"but got <class '([^']+)'>")
_NEVER_IN_WEIGHTS = re.compile(
    r"(os|posix|nt|sys|subprocess|shutil|socket|runpy|importlib|io|_?pickle|marshal|pty|ctypes|webbrowser)\."
    r"|(builtins|__builtin__)\.(eval|exec|execfile|compile|open|getattr|setattr|apply|input|breakpoint|__import__)$"
)


def read_file(path: Path) -> tuple[Any, dict[str, str]]:
    """Read the content and the metadata of a checkpoint. Only safetensors files have metadata.

    path: a safetensors file; a file of torch.save, which is read with `weights_only=True`; the index of a sharded
        checkpoint; or a folder with one of these. The content decides, not the name.
    Raises CheckpointError if the file cannot be parsed, and OSError if it does not exist or there is no permission to
    read it.
    """
    path = find_checkpoint(path)
    check_not_a_shard(path)
    check_regular_file(path, _MAX_FILE_BYTES, CheckpointError)
    if checkpoint_format(path) == "shard index":
        return read_sharded(path, _read_single)
    return _read_single(path)


def read_metadata(path: Path) -> dict[str, str]:
    """Read the metadata of a checkpoint, without its tensors. It is empty for a file that is not safetensors.

    Of a sharded checkpoint, this is the metadata that all shards share.
    Raises CheckpointError if the file cannot be parsed, and OSError if it does not exist or there is no permission to
    read it.
    """
    path = find_checkpoint(path)
    check_regular_file(path, _MAX_FILE_BYTES, CheckpointError)
    files = find_shards(path) if checkpoint_format(path) == "shard index" else [path]
    items = [set(_read_single_metadata(file).items()) for file in files]
    return dict(set.intersection(*items))


def checkpoint_files(path: Path) -> list[Path]:
    """The files that make up a checkpoint: itself, or an index of shards and the shards. Sorted by name.

    Raises CheckpointError and OSError as `read_file` does.
    """
    path = find_checkpoint(path)
    check_regular_file(path, _MAX_FILE_BYTES, CheckpointError)
    shards = find_shards(path) if checkpoint_format(path) == "shard index" else {}
    return sorted([path, *shards], key=lambda file: file.name)


def _read_single_metadata(path: Path) -> dict[str, str]:
    check_regular_file(path, _MAX_FILE_BYTES, CheckpointError)
    if checkpoint_format(path) == "other" or not is_recognised(path):
        raise _unreadable(path)
    if checkpoint_format(path) == "pickle":
        return {}
    try:
        with path_for_native_code(path) as name, safe_open(name, framework="pt") as file:
            return file.metadata() or {}
    except (SafetensorError, OSError, ValueError) as error:
        raise _unreadable(path, error) from error


def _read_single(path: Path) -> tuple[Any, dict[str, str]]:
    """Read one file."""
    check_regular_file(path, _MAX_FILE_BYTES, CheckpointError)
    match checkpoint_format(path):
        case "safetensors":
            return _read_safetensors(path)
        case "pickle":
            _check_unpacked_size(path)
            return _read_pickle(path)
        case "shard index":
            raise CheckpointError(f"{path}: expected a shard with tensors; got an index of shards.")
    raise _unreadable(path)


def _check_unpacked_size(path: Path) -> None:
    """Refuse a zip archive that unpacks to far more than its size. torch.save does not compress."""
    with suppress(zipfile.BadZipFile, ValueError, NotImplementedError), zipfile.ZipFile(path) as archive:
        unpacked = sum(entry.file_size for entry in archive.infolist())
        if unpacked > max(_MAX_UNPACKED_BYTES, 4 * path.stat().st_size):
            raise CheckpointError(
                f"{path}: expected an archive that is not compressed, as torch.save writes it; got "
                f"{path.stat().st_size} bytes that unpack to {unpacked}. Save the weights again with torch.save."
            )


def _read_safetensors(path: Path) -> tuple[Any, dict[str, str]]:
    try:
        with path_for_native_code(path) as native, safe_open(native, framework="pt") as file:
            tensors, metadata = {name: file.get_tensor(name) for name in file.keys()}, file.metadata() or {}  # noqa: SIM118
    except (SafetensorError, OSError, ValueError) as error:
        raise _unreadable(path, error) from error
    if not is_intact(tensors, metadata):
        raise CheckpointError(
            f"{path}: expected the content that the hash in its metadata was computed from; got another one. The file "
            "is damaged, or another program changed it and kept the metadata. Copy the file again, or leave out the "
            f"metadata field {HASH_KEY!r}."
        )
    return tensors, metadata


def _read_pickle(path: Path) -> tuple[Any, dict[str, str]]:
    try:
        # An open file: from the name *.safetensors, torch 2.13 would conclude that the file is no pickle.
        # torch warns about pickle protocols that it may not support, and raises an exception if it does not.
        with path.open("rb") as file, warnings.catch_warnings(action="ignore"):
            return torch.load(file, map_location="cpu", weights_only=True), {}
    except Exception as error:  # depending on the damage: EOFError, UnpicklingError, RuntimeError, KeyError, ...
        raise _untrusted(path, error) or _unreadable(path, error) from error


def _untrusted(path: Path, error: Exception) -> CheckpointError | None:
    """The error for a pickle that contains more than tensors and plain values. None if it failed for another reason."""
    match = _REFUSED_GLOBAL.search(str(error)) or _REFUSED_CLASS.search(str(error))
    outline = read_outline(path)
    # Of newer pickle protocols, torch names an instruction that it does not support, and no object.
    dangerous = sorted(filter(_NEVER_IN_WEIGHTS.match, outline.names)) if outline else []
    if match is None and not dangerous:
        return None
    name = match[1] if match else dangerous[0]
    # torch names only the first refused object, and builtins without their module.
    names = {name if "." in name else f"builtins.{name}", *(outline.names if outline else ())}
    if "." not in name or any(_NEVER_IN_WEIGHTS.match(other) for other in names):
        advice = "Weights never need it: do not open the file in any other way."
    else:
        code = code_to_save_tensors(path, outline) if outline else None
        advice = (
            "Do this only if you trust whoever made it: on the machine where it was made, save the tensors alone. "
            + (f"In Python: {code}." if code else "Save model.state_dict() with torch.save.")
        )
    return CheckpointError(
        f"{path}: expected a weights-only .pth, with tensors and plain values; got {path.stat().st_size} bytes that "
        f"ask for {name if name.isprintable() else ascii(name)}, which could run code. {advice}"
    )


def _unreadable(path: Path, error: Exception | None = None) -> CheckpointError:
    name = f" ({type(error).__name__})" if error else ""
    cause = (
        describe_other_kind(path)
        or f"the file is truncated, damaged or of another kind{name}; copy or download it again"
    )
    return CheckpointError(
        f"{path}: expected .safetensors or a weights-only .pth; got {path.stat().st_size} bytes: {cause}."
    )
