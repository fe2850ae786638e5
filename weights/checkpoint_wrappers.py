"""Wrappers: the dictionaries and name prefixes that training code puts around the weights in a checkpoint."""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from torch import Tensor

# Dictionary keys, or prefixes of tensor names, under which training code saves weights. If a file holds several copies,
# the first in this list is used: an average (EMA) of the weights is preferred to the raw weights.
#   state_dict_ema, model_ema: averages of timm, whose `load_state_dict` prefers them in this order, and of
#       torchvision's reference training. ema_model, ema: averages of other trainers.
#   module: DataParallel and torch's AveragedModel. _orig_mod: torch.compile. model: Lightning, among others.
#   ema_state_dict: mmengine's EMAHook swaps the two copies before saving (`_swap_ema_state_dict`), so there
#       `state_dict` is the average and `ema_state_dict` holds the raw weights.
_WRAPPERS = (
    *("state_dict_ema", "model_ema", "ema_model", "ema"),
    *("state_dict", "model_state_dict", "model", "module", "_orig_mod"),
    "ema_state_dict",
)
_COUNTERS = {"n_averaged", "steps"}  # of torch's AveragedModel and of mmengine; they are next to the prefixed tensors
_MAX_DEPTH = 8  # a dictionary in a pickle may contain itself


class Unwrapped(NamedTuple):
    """The weights found in a checkpoint.

    tensors: the tensors by name, without wrappers. If the checkpoint holds no named tensors, its content as it is.
    wrappers: the wrappers around them, outermost first.
    left_aside: full names of the tensors that were not used.
    notes: remarks on the choice between several copies.
    """

    tensors: Any
    wrappers: tuple[str, ...]
    left_aside: tuple[str, ...]
    notes: tuple[str, ...]


def unwrap(content: Any) -> Unwrapped:
    """Find the weights to deploy in the content of a checkpoint, e.g. {"state_dict": {"module.conv1.weight": ...}}."""
    wrappers: list[str] = []
    left_aside: list[str] = []
    notes: list[str] = []
    for _ in range(_MAX_DEPTH):
        copies = _find_copies(content)
        if not copies:
            break
        used, *unused = copies
        path = ".".join([*wrappers, ""])
        left_aside += [path + name for name in _unused_tensors(content, used, unused)]
        if unused:
            notes.append(_note_on_copies(path + used, [path + name for name in unused]))
        wrappers.append(used)
        content = copies[used]
    ema_buffers = _mmcv_ema_buffers(content) if is_state_dict(content) else set()
    if ema_buffers:
        notes.append(_NOTE_ON_EMA_BUFFERS)
        left_aside += [".".join([*wrappers, name]) for name in content if name in ema_buffers]
        content = {name: tensor for name, tensor in content.items() if name not in ema_buffers}
    return Unwrapped(content, tuple(wrappers), tuple(left_aside), tuple(notes))


def is_state_dict(content: Any) -> bool:
    """Whether the content is a dictionary of named tensors and nothing else."""
    return isinstance(content, Mapping) and all(
        isinstance(name, str) and isinstance(value, Tensor) for name, value in content.items()
    )


_NOTE_ON_EMA_BUFFERS = (
    "the file has a tensor ema_* for each weight: used the plain names. mmcv's EMAHook swaps the two at the end of an "
    "epoch, so the plain names hold the average if the file was saved then, and the raw weights otherwise"
)


def _note_on_copies(used: str, unused: list[str]) -> str:
    swapped = ""
    if unused[-1].endswith("ema_state_dict"):
        swapped = " (the average: mmengine swaps it with the raw weights before it saves)"
    return f"the file holds several copies of the weights: used {used}{swapped}; ignored {', '.join(unused)}"


def _find_copies(content: Any) -> dict[str, Mapping[str, Any]]:
    """The copies of the weights in a dictionary, by wrapper, preferred first. Empty if it has no wrappers."""
    if not isinstance(content, Mapping):
        return {}
    groups = _group_by_prefix(content) if is_state_dict(content) else content
    copies = {name: groups[name] for name in _WRAPPERS if isinstance(groups.get(name), Mapping)}
    return {name: copy for name, copy in copies.items() if _holds_tensors(copy)}


def _holds_tensors(content: Mapping[str, Any]) -> bool:
    """Whether there is a tensor at any depth. Some trainers save an empty copy, or only the settings of the average."""
    return next(_tensor_names(content), None) is not None


def _group_by_prefix(tensors: Mapping[str, Tensor]) -> dict[str, dict[str, Tensor]]:
    """Convert {"module.a": x} to {"module": {"a": x}}. The result is empty unless every name has a known prefix."""
    groups: dict[str, dict[str, Tensor]] = {}
    for name, tensor in tensors.items():
        prefix, _, rest = name.partition(".")
        if rest and prefix in _WRAPPERS:
            groups.setdefault(prefix, {})[rest] = tensor
        elif name not in _COUNTERS:
            return {}
    return groups


def _unused_tensors(content: Mapping[str, Any], used: str, unused: list[str]) -> Iterator[str]:
    """Names of the tensors in a dictionary of copies that do not belong to the copy that is used."""
    if is_state_dict(content):
        yield from (name for name in content if not name.startswith(f"{used}."))
    else:
        for copy in unused:
            yield from (f"{copy}.{name}" for name in _tensor_names(content[copy]))


def _tensor_names(content: Mapping[str, Any], seen: frozenset[int] = frozenset()) -> Iterator[str]:
    for name, value in content.items():
        if isinstance(value, Tensor):
            yield str(name)
        elif isinstance(value, Mapping) and len(seen) < _MAX_DEPTH and id(value) not in seen:
            yield from (f"{name}.{inner}" for inner in _tensor_names(value, seen | {id(value)}))


def _mmcv_ema_buffers(tensors: Mapping[str, Tensor]) -> set[str]:
    """The names of the buffers of mmcv's EMAHook: ema_layer1_0_weight is the copy of layer1.0.weight."""
    return {f"ema_{name.replace('.', '_')}" for name in tensors} & tensors.keys()
