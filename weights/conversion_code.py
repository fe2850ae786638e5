"""Python code that saves the weights of a refused pickle as tensors only."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from .pickle_outline import ArrayPlaceholder, Outline, Placeholder, TensorPlaceholder

_MAX_NODES = 100_000
_MAX_DEPTH = 6

# Templates of Python code that selects the weights.
_TENSORS = "{}"
_TENSORS_AND_OTHERS = "{{name: value for name, value in {}.items() if isinstance(value, torch.Tensor)}}"
_ARRAYS = "{{name: torch.as_tensor(value) for name, value in {}.items()}}"
_MODULE = "{}.state_dict()"


def code_to_save_tensors(path: Path, outline: Outline) -> str | None:
    """Python code that saves the weights of a trusted file as tensors only. None if it has no weights.

    The code unpickles the file without restrictions: the caller must say so.
    """
    # torch.load reads a name that ends in .safetensors as that format, whatever the content.
    file = f"open({str(path)!r}, 'rb')" if path.suffix == ".safetensors" else repr(str(path))
    loaded = f'torch.load({file}, map_location="cpu", weights_only=False)'
    selection = _select_clean_entries(outline.content) or _select_place(outline.content)
    return None if selection is None else f'torch.save({selection.format(loaded)}, "tensors.pth")'


def _select_clean_entries(content: Any) -> str | None:
    """Select the entries of a dictionary that hold only tensors and plain values, such as two copies of the weights.

    None if there are fewer than two.
    """
    if not isinstance(content, dict) or isinstance(content, Placeholder):
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
        if isinstance(node, TensorPlaceholder):
            num_tensors += 1
        elif isinstance(node, Placeholder) or len(nodes) > _MAX_NODES:
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
        if isinstance(node, Placeholder) and "_parameters" in node.state and "_modules" in node.state:
            yield 1, keys, _MODULE
        if not isinstance(node, dict) or isinstance(node, Placeholder):
            continue
        num_tensors = sum(isinstance(value, TensorPlaceholder) for value in node.values())
        num_arrays = sum(isinstance(value, ArrayPlaceholder) for value in node.values())
        if num_tensors:
            yield num_tensors, keys, _TENSORS if num_tensors == len(node) else _TENSORS_AND_OTHERS
        elif num_arrays and num_arrays == len(node):
            yield num_arrays, keys, _ARRAYS
        if len(keys) < _MAX_DEPTH and len(nodes) < _MAX_NODES:
            nodes += [((*keys, key), value) for key, value in node.items() if _is_key(key) and isinstance(value, dict)]


def _is_key(key: Any) -> bool:
    return type(key) in (str, int) and key not in ("optimizer", "optimizer_states", "optimizer_state_dict")
