"""The outline of a pickle that was refused: where its tensors are. Nothing that the pickle names is imported or called.

A refused file often holds ordinary weights beside an object of its training code. The outline tells under which keys.
"""

import io
import pickle
import zipfile
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

_MAX_BYTES = 64_000_000  # of the pickle, without the numbers of the tensors
_LEGACY_MAGIC = 0x1950A86A20F9469CFC6C  # torch.save without a zip archive: magic number, protocol, system, content
# These allocate any amount of memory, or use a registry of this process.
_REFUSED_OPCODES = (pickle.BYTEARRAY8, pickle.EXT1, pickle.EXT2, pickle.EXT4, pickle.NEXT_BUFFER)


class Outline(NamedTuple):
    """The dictionaries, lists and plain values of a pickle, with placeholders for all other objects.

    names: of all classes and functions that unpickling the file would import.
    """

    content: Any
    names: frozenset[str]


def read_outline(path: Path) -> Outline | None:
    """Read the outline of a file of torch.save or pickle. None if it cannot be parsed."""
    try:
        return _read_outline(path)
    except Exception:  # a damaged or malicious pickle can fail in any way
        return None


def _read_outline(path: Path) -> Outline:
    stream, names = io.BytesIO(_read_pickle(path)), set[str]()
    content = _load(stream, names)
    if content == _LEGACY_MAGIC:
        for _ in range(3):
            content = _load(stream, names)
    return Outline(content, frozenset(names))


def _load(stream: io.BytesIO, names: set[str]) -> Any:
    """Read the next pickle of a stream, and add the names in it to `names`."""
    unpickler = _OutlineUnpickler(stream)
    content = unpickler.load()
    names |= unpickler.names
    return content


def _read_pickle(path: Path) -> bytes:
    if not zipfile.is_zipfile(path):
        with path.open("rb") as file:
            return file.read(_MAX_BYTES)
    with zipfile.ZipFile(path) as archive:
        name = next(name for name in archive.namelist() if name.endswith("data.pkl"))
        with archive.open(name) as file:
            return file.read(_MAX_BYTES)


class Placeholder(dict):
    """Stands for an object of any class. It accepts everything that unpickling does to an object, and does nothing."""

    state: dict[str, Any]
    __hash__ = object.__hash__  # type: ignore[assignment]  # it may be the key of a dictionary
    __eq__ = object.__eq__

    def __new__(cls, *_: Any, **__: Any) -> "Placeholder":
        placeholder = super().__new__(cls)
        placeholder.state = {}
        return placeholder

    def __init__(self, *_: Any, **__: Any) -> None:
        super().__init__()

    def __setstate__(self, state: Any) -> None:
        self.state = state if isinstance(state, dict) else {}

    def append(self, _: Any) -> None:
        """Ignore an element of a list."""

    def extend(self, _: Any) -> None:
        """Ignore the elements of a list."""


class TensorPlaceholder(Placeholder):
    """Stands for a tensor."""


class ArrayPlaceholder(Placeholder):
    """Stands for a NumPy array."""


class _OutlineUnpickler(pickle._Unpickler):  # the one in Python, whose memo cannot be made to take all memory
    """Builds dictionaries, lists and plain values. Every class and function is replaced by a placeholder."""

    dispatch: ClassVar = {
        opcode: load for opcode, load in pickle._Unpickler.dispatch.items() if bytes([opcode]) not in _REFUSED_OPCODES
    }

    def __init__(self, stream: io.BytesIO) -> None:
        super().__init__(stream)
        self.names: set[str] = set()

    def find_class(self, module: str, name: str) -> Any:
        """A placeholder for the named class or function; a dictionary for an ordered one."""
        self.names.add(f"{module}.{name}")
        if (module, name) == ("collections", "OrderedDict"):
            return _OrderedDict
        if module == "torch._utils" and name.startswith("_rebuild_"):
            return type(name, (TensorPlaceholder,), {})
        if name == "_reconstruct" and module.startswith("numpy"):
            return type(name, (ArrayPlaceholder,), {})
        return type("Placeholder", (Placeholder,), {})

    def persistent_load(self, reference: Any) -> Any:
        """A placeholder for the numbers of a tensor. torch's old format also refers to the classes of modules so."""
        is_class = isinstance(reference, tuple) and len(reference) > 1 and reference[0] == "module"
        return reference[1] if is_class else Placeholder()


class _OrderedDict(dict):
    """A dictionary that ignores the attributes of an OrderedDict, such as the `_metadata` of a state dict."""

    def __init__(self, *_: Any) -> None:
        super().__init__()

    def __setstate__(self, _: Any) -> None:
        """Ignore the attributes."""
