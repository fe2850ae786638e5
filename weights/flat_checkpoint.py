"""All tensors of a checkpoint in one dictionary: its nested dictionaries and lists become prefixes of the names."""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from torch import Tensor

# torch.compile, FSDP and activation checkpointing put these into the names of the modules that they wrap.
_WRAPPING_MODULES = {"_orig_mod", "_fsdp_wrapped_module", "_checkpoint_wrapped_module", "_forward_module"}
# Keys of the state of a training. Optimizers keep one or two tensors per weight, sometimes under the weight's name.
_TRAINING_STATE = (
    *("optimizer", "optimizers", "optimizer_state_dict", "optimizer_state", "optimizer_states", "optim", "opt"),
    *("scheduler", "schedulers", "lr_scheduler", "lr_schedulers", "scaler", "grad_scaler", "loops", "rng_state"),
)
_MAX_DEPTH = 12
_MAX_ENTRIES = 1_000_000  # dictionaries with shared content can have any number of paths


class UnwrapError(ValueError):
    """The weights in a checkpoint cannot be determined. The message does not name the file."""


class FlatCheckpoint(NamedTuple):
    """The tensors of a checkpoint.

    tensors: by the dotted path of their keys, such as "state_dict.module.conv1.weight".
    unnamed: paths of the lists that hold tensors without names.
    """

    tensors: dict[str, Tensor]
    unnamed: tuple[str, ...]


def flatten_checkpoint(content: Any) -> FlatCheckpoint:
    """Collect the named tensors in nested dictionaries and lists. Optimizer states and plain values are left out.

    Raises UnwrapError if two tensors have the same path, or if there are too many entries.
    """
    tensors: dict[str, Tensor] = {}
    unnamed: dict[str, None] = {}
    for index, (path, key, tensor) in enumerate(_walk(content, (), frozenset(), set())):
        if index == _MAX_ENTRIES:
            raise UnwrapError(f"expected at most {_MAX_ENTRIES} tensors; got more. Save model.state_dict() alone")
        if not isinstance(key, str):
            unnamed[".".join(path)] = None
            continue
        name = _plain_name((*path, key))
        if name in tensors:
            raise UnwrapError(f"expected one tensor {name}; got two. Save model.state_dict() alone")
        tensors[name] = tensor
    return FlatCheckpoint(tensors, tuple(unnamed))


def _walk(
    content: Any, path: tuple[str, ...], ancestors: frozenset[int], without_tensors: set[int]
) -> Iterator[tuple[tuple[str, ...], Any, Tensor]]:
    """The path, the last key and the value of each tensor.

    ancestors: containers around `content`; a dictionary in a pickle may contain itself.
    without_tensors: containers without tensors. Each is searched once, because it may occur any number of times.
    """
    if (
        not isinstance(content, Mapping | list | tuple)
        or id(content) in ancestors | without_tensors
        or len(path) > _MAX_DEPTH
    ):
        return
    num_found = 0
    for key, value in content.items() if isinstance(content, Mapping) else enumerate(content):
        if isinstance(value, Tensor):
            num_found += 1
            yield path, key, value
        elif not (isinstance(key, str) and key in _TRAINING_STATE):
            for found in _walk(value, (*path, str(key)), ancestors | {id(content)}, without_tensors):
                num_found += 1
                yield found
    if num_found == 0:
        without_tensors.add(id(content))


def _plain_name(path: tuple[str, ...]) -> str:
    """The dotted name of a tensor, without wrapping modules, and with escapes for characters that cannot be printed."""
    parts = [part for part in ".".join(path).split(".") if part not in _WRAPPING_MODULES]
    name = ".".join(parts)
    return name if name.isprintable() else name.encode("unicode_escape", "backslashreplace").decode()
