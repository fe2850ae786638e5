"""Wrappers: the dictionaries and name prefixes that training code puts around the weights in a checkpoint."""

import re
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import NamedTuple

from torch import Tensor

from .checkpoint_layout import FOREIGN_LAYOUTS, Layout
from .copy_choice import CopyChoice, choose_copy, is_average, shorten_text
from .flat_checkpoint import UnwrapError, flatten_checkpoint

# Keys and prefixes of common training code. `module`: DataParallel and torch's AveragedModel. `model`: Lightning.
_COMMON_WRAPPERS = {
    *("state_dict", "model_state_dict", "model_state", "model", "module", "net", "network", "detector", "weights"),
    *("state_dict_ema", "model_ema", "ema_model", "ema_state_dict", "ema", "shadow", "averaged_model"),
}
_MAX_SETTINGS = 3  # tensors of an average that are not weights, such as its decay
_MAX_PARTS = 16  # of a tensor's name, that are searched for wrappers


class Unwrapped(NamedTuple):
    """The weights found in a checkpoint.

    tensors: the tensors by name, without wrappers. Empty if the checkpoint has no named tensors.
    wrappers: the keys and prefixes around them, outermost first.
    left_aside: full names of the tensors that were not used. Optimizer states are not listed.
    notes: remarks on the choice between several copies.
    """

    tensors: dict[str, Tensor]
    wrappers: tuple[str, ...]
    left_aside: tuple[str, ...]
    notes: tuple[str, ...]


def unwrap(content: object, expected: Collection[str], key: str | None = None) -> Unwrapped:
    """Find the weights to deploy in the content of a checkpoint, e.g. {"state_dict": {"module.conv1.weight": ...}}.

    expected: the names of the model's tensors. The wrappers are what precedes these names, or those of a known layout.
    key: the dotted keys of the weights, to choose between several copies.

    An average (EMA) of the weights is preferred to the raw weights. Tensors that it lacks, such as the statistics of
    norms, are taken from the raw weights, as trainers do.
    Raises UnwrapError if the choice between several copies is not clear, or if there are no weights under `key`.
    """
    flat = flatten_checkpoint(content)
    copies = _split(flat.tensors, _find_copies(list(flat.tensors), expected, key))
    chosen = choose_copy(copies, flat.tensors)
    tensors = copies[chosen.prefix]
    raw = copies[chosen.completed_by] if chosen.completed_by is not None else {}
    completed = {name: tensor for name, tensor in raw.items() if name not in tensors}
    buffers = _mmcv_ema_buffers(tensors)
    kept = {name: tensor for name, tensor in (tensors | completed).items() if name not in buffers}
    used = {chosen.prefix + name for name in tensors if name in kept}
    used |= {f"{chosen.completed_by}{name}" for name in completed if name in kept}
    left_aside = tuple(name for name in flat.tensors if name not in used)
    notes = _notes_on_choice(chosen, len(completed)) + _notes_on_unused_averages(copies, left_aside, flat.unnamed)
    if buffers:
        notes.append(_NOTE_ON_EMA_BUFFERS)
    return Unwrapped(kept, tuple(part for part in chosen.prefix.split(".") if part), left_aside, tuple(notes))


_NOTE_ON_EMA_BUFFERS = (
    "the file has a tensor ema_* for each weight: used the plain names. mmcv's EMAHook swaps the two at the end of an "
    "epoch, so the plain names hold the average if the file was saved then, and the raw weights otherwise"
)


def _find_copies(names: list[str], expected: Collection[str], key: str | None) -> list[str]:
    """The prefixes of the copies of the weights in a file. There is always at least one.

    A copy has at least a quarter of the tensors of the largest. An average often lacks the statistics of norms.
    """
    start = _checked_key(names, key)
    inner = [name.removeprefix(start) for name in names if name.startswith(start)]
    counts = _count_prefixes(inner, expected)
    copies = [prefix for prefix, count in counts.items() if 4 * count >= max(counts.values())]
    if "" in copies:  # the tensors outside are then part of the same model, unless they are known copies of it
        copies = [prefix for prefix in copies if not prefix or _is_common(prefix) or is_average(prefix)]
    return [start + prefix for prefix in copies]


def _split(tensors: Mapping[str, Tensor], copies: list[str]) -> dict[str, dict[str, Tensor]]:
    """The tensors of each copy, by prefix and by the rest of their names. One prefix may be the start of another."""
    groups: dict[str, dict[str, Tensor]] = {copy: {} for copy in copies}
    longest_first = sorted(copies, key=len, reverse=True)
    for name, tensor in tensors.items():
        copy = next((copy for copy in longest_first if name.startswith(copy)), None)
        if copy is not None:
            groups[copy][name.removeprefix(copy)] = tensor
    return groups


def _checked_key(names: list[str], key: str | None) -> str:
    """The prefix of tensors under a key. Raises UnwrapError if there are none."""
    if key is None:
        return ""
    start = f"{key.removesuffix('.')}."
    if not any(name.startswith(start) for name in names):
        tops = ", ".join(dict.fromkeys(name.split(".")[0] for name in names))
        raise UnwrapError(f"--weights-key {key}: expected a key with tensors; the file has {shorten_text(tops)}")
    return start


def _count_prefixes(names: list[str], expected: Collection[str]) -> Counter[str]:
    """The number of weights by prefix, for the model's own names or else for the first layout that occurs."""
    marks: list[tuple[Callable[[str], bool], bool]] = [(lambda name: name in expected, False)]
    marks += [(_starts_with(layout), layout.bare) for layout in FOREIGN_LAYOUTS]
    for is_weight, bare in marks:
        prefixes = (_prefix(name, is_weight) for name in names)
        counts = Counter(prefix for prefix in prefixes if prefix is not None and (not bare or _is_common(prefix)))
        if counts:
            return counts
    most_common = Counter(map(_common_prefix, names)).most_common(1)
    return Counter([prefix for prefix, _ in most_common] or [""])


def _starts_with(layout: Layout) -> Callable[[str], bool]:
    return lambda name: re.match(layout.mark, name) is not None


def _prefix(name: str, is_weight: Callable[[str], bool]) -> str | None:
    """The shortest prefix after which the rest of a name is that of a weight. None if there is none."""
    parts = name.split(".", _MAX_PARTS)
    for index in range(len(parts)):
        if is_weight(".".join(parts[index:])):
            return "".join(f"{part}." for part in parts[:index])
    return None


def _common_prefix(name: str) -> str:
    """The common wrappers at the start of a name."""
    parts = name.split(".", _MAX_PARTS)
    length = next((index for index, part in enumerate(parts) if part not in _COMMON_WRAPPERS), 0)
    return "".join(f"{part}." for part in parts[:length])


def _is_common(prefix: str) -> bool:
    return all(part in _COMMON_WRAPPERS for part in prefix.split(".")[:-1])


def _mmcv_ema_buffers(tensors: Mapping[str, Tensor]) -> set[str]:
    """The names of the buffers of mmcv's EMAHook: ema_layer1_0_weight is the copy of layer1.0.weight."""
    return {f"ema_{name.replace('.', '_')}" for name in tensors} & tensors.keys()


def _notes_on_choice(choice: CopyChoice, num_completed: int) -> list[str]:
    if not choice.ignored:
        return []
    used, *ignored = (prefix.removesuffix(".") or "the top level" for prefix in (choice.prefix, *choice.ignored))
    reason = f" ({choice.reason})" if choice.reason else ""
    completed = f", except for {num_completed} tensors that {used} lacks" if num_completed else ""
    return [
        f"the file holds several copies of the weights: used {used}{reason}; ignored {', '.join(ignored)}{completed}"
    ]


def _notes_on_unused_averages(copies: Collection[str], left_aside: Iterable[str], unnamed: Iterable[str]) -> list[str]:
    """A note on averages that are not a copy of the model, for example because their tensors have no names."""
    tops = Counter(name.split(".")[0] for name in left_aside if "." in name)
    known = {copy.split(".")[0] for copy in copies}
    # The average's settings, such as its decay, may be tensors too.
    averages = [top for top, count in tops.items() if count > _MAX_SETTINGS and is_average(top) and top not in known]
    averages += [path for path in unnamed if is_average(path)]
    if not averages:
        return []
    return [f"an average without the model's tensor names is not used: {shorten_text(', '.join(averages))}"]
