"""The format of a checkpoint file, from its content: its name often says something else."""

import re
import shlex
import struct
import zipfile
from pathlib import Path
from typing import Literal

_START_BYTES = 512
MAX_INDEX_BYTES = 100_000_000
_MAX_SAFETENSORS_HEADER = 100_000_000  # bytes; the limit of the safetensors package

# By their first bytes, kinds of files that are not checkpoints of PyTorch, and what to do about each.
_PYTORCH_SOURCE = "save model.state_dict() in PyTorch instead"
_SIGNATURES: tuple[tuple[bytes, str, str], ...] = (
    (b"version https://git-lfs", "a git-lfs pointer", "fetch the content with `git lfs pull`"),
    (b"\x1f\x8b", "compressed with gzip", "unpack it with `gunzip -c {shell} > unpacked.pth`"),
    (b"BZh", "compressed with bzip2", "unpack it with `bunzip2 -c {shell} > unpacked.pth`"),
    (b"\xfd7zXZ\x00", "compressed with xz", "unpack it with `xz -dc {shell} > unpacked.pth`"),
    (b"\x28\xb5\x2f\xfd", "compressed with zstd", "unpack it with `zstd -dc {shell} > unpacked.pth`"),
    (b"7z\xbc\xaf\x27\x1c", "a 7z archive", "unpack it"),
    (b"Rar!", "a RAR archive", "unpack it"),
    (b"\x89HDF\r\n\x1a\n", "an HDF5 file, as Keras and TensorFlow write it", _PYTORCH_SOURCE),
    (b"GGUF", "a GGUF file", _PYTORCH_SOURCE),
    (
        b"\x93NUMPY",
        "a single NumPy array without a name",
        "save all arrays with their names in PyTorch, with torch.save",
    ),
    (b"\x89PNG", "an image", "name the checkpoint"),
    (b"\xff\xd8\xff", "an image", "name the checkpoint"),
    (b"%PDF", "a PDF document", "name the checkpoint"),
)
_ONNX = "an ONNX model", "export works in the other direction: name the PyTorch checkpoint that it was exported from"
_DOWNLOAD = "download the checkpoint itself"
# Python code.
_NUMPY_TO_TORCH = (
    'torch.save({{name: torch.from_numpy(array) for name, array in numpy.load({python}).items()}}, "tensors.pth")'
)
_TORCHSCRIPT_TO_TORCH = 'torch.save(torch.jit.load({python}, map_location="cpu").state_dict(), "tensors.pth")'
_PROGRAM_TO_TORCH = 'torch.save(dict(torch.export.load({python}).state_dict), "tensors.pth")'


def checkpoint_format(path: Path) -> Literal["safetensors", "pickle", "shard index", "other"]:
    """The format of a regular file.

    "pickle" is the format of torch.save, in a zip archive or not, and also anything that is not recognised.
    "shard index" lists the files of a sharded checkpoint. `describe_other_kind` names the others.
    """
    start = _read_start(path)
    if _is_safetensors(start):
        return "safetensors"
    if _is_json(start) and path.stat().st_size <= MAX_INDEX_BYTES and b'"weight_map"' in path.read_bytes():
        return "shard index"
    return "pickle" if describe_other_kind(path) is None else "other"


def describe_other_kind(path: Path) -> str | None:
    """Say what a file is that is not a checkpoint, and what to do. None if it is not recognised."""
    start = _read_start(path)
    kind = _kind_of_zip(path) if start.startswith(b"PK\x03\x04") else _kind_of_start(start)
    if kind is None:
        return None
    name, advice = kind
    return f"the file is {name}; {advice.format(shell=shlex.quote(str(path)), python=repr(str(path)))}"


def is_recognised(path: Path) -> bool:
    """Whether the file starts like one of safetensors, of torch.save, or of another known kind."""
    start = _read_start(path)
    return _is_safetensors(start) or start.startswith((b"PK", b"\x80")) or describe_other_kind(path) is not None


def _read_start(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(_START_BYTES)


def _is_safetensors(start: bytes) -> bool:
    """Whether the file starts with the length of a JSON header, and the header."""
    return start[8:9] == b"{" and 2 <= struct.unpack("<Q", start[:8])[0] <= _MAX_SAFETENSORS_HEADER


def _is_json(start: bytes) -> bool:
    return re.match(rb'\s*[{\[]\s*["{\[\]}]', start.removeprefix(b"\xef\xbb\xbf")) is not None


def _kind_of_start(start: bytes) -> tuple[str, str] | None:
    if not start:
        return "empty", "copy or download it again"
    for signature, name, advice in _SIGNATURES:
        if start.startswith(signature):
            return name, advice
    if start[257:262] == b"ustar":
        return "a tar archive", "unpack it with `tar -xf {shell}`"
    if start[4:8] == b"TFL3":
        return "a TensorFlow Lite model", _PYTORCH_SOURCE
    return _kind_of_text(start) or _kind_of_protobuf(start)


def _kind_of_text(start: bytes) -> tuple[str, str] | None:
    text = start.removeprefix(b"\xef\xbb\xbf").lstrip().lower()
    if text.startswith((b"<!doctype", b"<html", b"<head", b"<body", b"<!--")):
        return "a web page", _DOWNLOAD
    if text.startswith(b"<?xml"):
        return "an XML text, perhaps the error message of a server", _DOWNLOAD
    if _is_json(start):
        return "a JSON text", "name the checkpoint, or an index such as model.safetensors.index.json"
    return None


def _kind_of_protobuf(start: bytes) -> tuple[str, str] | None:
    """Recognise the first two fields: in ONNX the version of the format, then a producer, a domain or a graph."""
    if len(start) < 3 or start[0] != 0x08:
        return None
    if start[1] == 1 and start[2] == 0x12:
        return "a TensorFlow SavedModel", _PYTORCH_SOURCE
    return _ONNX if 3 <= start[1] <= 32 and start[2] in (0x12, 0x1A, 0x22, 0x3A, 0x42) else None


def _kind_of_zip(path: Path) -> tuple[str, str] | None:
    """None if the archive cannot be read, or if it is one of torch.save."""
    try:
        with zipfile.ZipFile(path) as archive:
            names = [name.partition("/")[2] or name for name in archive.namelist()]
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError):
        return None
    if "constants.pkl" in names and any(name.startswith("code/") for name in names):
        return "a TorchScript archive", f"if you trust it, save its tensors in Python: {_TORCHSCRIPT_TO_TORCH}"
    if "data.pkl" in names:
        return None
    if "archive_format" in names and any(name.startswith("models/") for name in names):
        return "an exported program", f"if you trust it, save its tensors in Python: {_PROGRAM_TO_TORCH}"
    if any(name.endswith(".npy") for name in names):
        return "an archive of NumPy arrays (.npz)", f"convert it in Python: {_NUMPY_TO_TORCH}"
    shown = ", ".join(ascii(name)[1:-1] for name in names[:3])
    return f"a zip archive of other files ({shown.replace('{', '(').replace('}', ')')})", "unpack it"
