"""The outline of a pickle that was refused: where its tensors are. Nothing that the pickle names is imported or called.

A refused file often holds ordinary weights beside an object of its training code. The outline tells under which keys.
"""

import io
import pickle
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

_MAX_BYTES = 64_000_000  # of the pickle, without the numbers of the tensors
_MAX_NODES = 100_000
_MAX_DEPTH = 6
_LEGACY_MAGIC = 0x1950A86A20F9469CFC6C  # torch.save without a zip archive: magic number, protocol, system, content


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


def code_to_save_tensors(path: Path, outline: Outline) -> str | None:
    """Python code that saves the weights of a trusted file as tensors only. None if it has no weights.

    The code unpickles the file without restrictions: the caller must say so.
    """
    # torch.load reads a name that ends in .safetensors as that format, whatever the content.
    file = f"open({str(path)!r}, 'rb')" if path.suffix == ".safetensors" else repr(str(path))
    loaded = f'torch.load({file}, map_location="cpu", weights_only=False)'
    selection = _select_clean_entries(outline.content) or _select_place(outline.content)
    return None if selection is None else f'torch.save({selection.format(loaded)}, "tensors.pth")'


# --- Where the weights are ----------------------------------------------------------------------------------------

# Templates of Python code that selects the weights.
_TENSORS = "{}"
_TENSORS_AND_OTHERS = "{{name: value for name, value in {}.items() if isinstance(value, torch.Tensor)}}"
_ARRAYS = "{{name: torch.as_tensor(value) for name, value in {}.items()}}"
_MODULE = "{}.state_dict()"


def _select_clean_entries(content: Any) -> str | None:
    """Select the entries of a dictionary that hold tensors and plain values, if there are several, such as two copies
    of the weights. None otherwise."""
    if not isinstance(content, dict) or isinstance(content, _Placeholder):
        return None
    keys = tuple(key for key, value in content.items() if _is_key(key) and _is_clean(value))
    if len(keys) < 2:
        return None
    listed = repr(keys).replace("{", "{{").replace("}", "}}")
    return f"{{{{key: value for key, value in {{}}.items() if key in {listed}}}}}"


def _is_clean(value: Any) -> bool:
    """Whether there are tensors and no other objects."""
    nodes, num_tensors = [value], 0
    for node in nodes:
        if isinstance(node, _TensorPlaceholder):
            num_tensors += 1
        elif isinstance(node, _Placeholder) or len(nodes) > _MAX_NODES:
            return False
        elif isinstance(node, dict | list | tuple):
            nodes += node.values() if isinstance(node, dict) else node
    return num_tensors > 0


def _select_place(content: Any) -> str | None:
    """Select the dictionary with the most tensors. None if there is none."""
    place = max(_places(content), key=lambda place: place[0], default=None)
    if place is None:
        return None
    _, keys, template = place
    indices = "".join(f"[{key!r}]" for key in keys).replace("{", "{{").replace("}", "}}")
    return template.replace("{}", f"{{}}{indices}")


def _places(content: Any) -> Iterator[tuple[int, tuple[Any, ...], str]]:
    """The places with weights: their number of tensors, their keys, and a template of the code that selects them."""
    nodes: list[tuple[tuple[Any, ...], Any]] = [((), content)]
    for keys, node in nodes:
        if isinstance(node, _Placeholder) and "_parameters" in node.state and "_modules" in node.state:
            yield 1, keys, _MODULE
        if not isinstance(node, dict) or isinstance(node, _Placeholder):
            continue
        num_tensors = sum(isinstance(value, _TensorPlaceholder) for value in node.values())
        num_arrays = sum(isinstance(value, _ArrayPlaceholder) for value in node.values())
        if num_tensors:
            yield num_tensors, keys, _TENSORS if num_tensors == len(node) else _TENSORS_AND_OTHERS
        elif num_arrays and num_arrays == len(node):
            yield num_arrays, keys, _ARRAYS
        if len(keys) < _MAX_DEPTH and len(nodes) < _MAX_NODES:
            nodes += [((*keys, key), value) for key, value in node.items() if _is_key(key) and isinstance(value, dict)]


def _is_key(key: Any) -> bool:
    return type(key) in (str, int) and key not in ("optimizer", "optimizer_states", "optimizer_state_dict")


# --- Reading without running anything -----------------------------------------------------------------------------


# These allocate any amount of memory, or use a registry of this process.
_REFUSED_OPCODES = (pickle.BYTEARRAY8, pickle.EXT1, pickle.EXT2, pickle.EXT4, pickle.NEXT_BUFFER)


class _Placeholder(dict):
    """Stands for an object of any class. It accepts everything that unpickling does to an object, and does nothing."""

    state: dict[str, Any]
    __hash__ = object.__hash__  # type: ignore[assignment]  # it may be the key of a dictionary
    __eq__ = object.__eq__

    def __new__(cls, *_: Any, **__: Any) -> "_Placeholder":
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


class _TensorPlaceholder(_Placeholder):
    """Stands for a tensor."""


class _ArrayPlaceholder(_Placeholder):
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
            return type(name, (_TensorPlaceholder,), {})
        if name == "_reconstruct" and module.startswith("numpy"):
            return type(name, (_ArrayPlaceholder,), {})
        return type("Placeholder", (_Placeholder,), {})

    def persistent_load(self, reference: Any) -> Any:
        """A placeholder for the numbers of a tensor. torch's old format also refers to the classes of modules so."""
        is_class = isinstance(reference, tuple) and len(reference) > 1 and reference[0] == "module"
        return reference[1] if is_class else _Placeholder()


class _OrderedDict(dict):
    """A dictionary that ignores the attributes of an OrderedDict, such as the `_metadata` of a state dict."""

    def __init__(self, *_: Any) -> None:
        super().__init__()

    def __setstate__(self, _: Any) -> None:
        """Ignore the attributes."""


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
