"""The choice between several copies of the weights in a checkpoint, such as an average and the raw weights."""

import re
import shlex
from collections.abc import Mapping
from typing import NamedTuple

import torch
from torch import Tensor

from .flat_checkpoint import UnwrapError

# Words in the keys of averages of the weights, and of the raw weights beside an average.
_AVERAGE_WORDS = {"ema", "swa", "shadow", "avg", "average", "averaged", "averaging", "polyak"}
_RAW_WORDS = {"online", "raw", "current"}


class CopyChoice(NamedTuple):
    """The copy of the weights that is used.

    prefix: of its tensor names.
    completed_by: the prefix of the raw weights that fill the gaps of an average.
    ignored: the prefixes of the other copies.
    reason: why this copy is used, if its prefix does not say it.
    """

    prefix: str
    completed_by: str | None = None
    ignored: tuple[str, ...] = ()
    reason: str = ""


def choose_copy(copies: Mapping[str, Mapping[str, Tensor]], tensors: Mapping[str, Tensor]) -> CopyChoice:
    """Choose the copy to deploy. Raises UnwrapError if that is not clear."""
    if len(copies) == 1:
        return CopyChoice(next(iter(copies)))
    if swapped := _choose_swapped(list(copies), tensors):
        return swapped
    averages = [copy for copy in copies if is_average(copy)]
    raw = [copy for copy in copies if copy not in averages]
    used, *others = averages or raw
    if any(not _are_equal(copies[used], copies[other]) for other in others):
        names = [copy.removesuffix(".") or "the top level" for copy in (used, *others)]
        example = max(used, *others, key=bool).removesuffix(".")  # the first that has a name
        raise UnwrapError(
            f"expected one copy of the weights; got {len(names)}: {shorten_text(', '.join(names))}. "
            f"Choose one, for example with --weights-key {shlex.quote(example)}"
        )
    completed_by = raw[0] if averages and raw else None
    return CopyChoice(used, completed_by, tuple(copy for copy in copies if copy != used))


def _choose_swapped(copies: list[str], tensors: Mapping[str, Tensor]) -> CopyChoice | None:
    """The choice for trainers that save the average of the weights under the usual name. None for other trainers.

    mmengine's EMAHook swaps the two (`_swap_ema_state_dict`); its average counts its updates in `steps`.
    Lightning's WeightAveraging moves the raw weights to `current_model_state`.
    """
    if len(copies) != 2:
        return None
    usual = next((copy for copy in copies if copy.startswith("state_dict.")), None)
    raw = next((copy for copy in copies if copy.startswith(("ema_state_dict.", "current_model_state."))), None)
    if usual is None or raw is None:
        return None
    if raw.startswith("current_model_state."):
        return CopyChoice(usual, None, (raw,), "the average: Lightning saves the raw weights as current_model_state")
    if "ema_state_dict.steps" in tensors:
        return CopyChoice(usual, None, (raw,), "the average: mmengine swaps it with the raw weights before it saves")
    return None


def is_average(prefix: str) -> bool:
    """Whether the keys say that a copy is an average of the weights. The innermost word decides."""
    for part in reversed(prefix.split(".")):
        words = set(re.findall(r"[a-z]+", re.sub(r"([a-z])([A-Z])", r"\1_\2", part).lower()))
        if words & _RAW_WORDS:
            return False
        if words & _AVERAGE_WORDS:
            return True
    return False


def _are_equal(one: Mapping[str, Tensor], other: Mapping[str, Tensor]) -> bool:
    return one.keys() == other.keys() and all(_is_equal(tensor, other[name]) for name, tensor in one.items())


def _is_equal(one: Tensor, other: Tensor) -> bool:
    dense = all(tensor.layout == torch.strided and tensor.device.type == "cpu" for tensor in (one, other))
    return one is other or (dense and one.dtype == other.dtype and torch.equal(one, other))


def shorten_text(text: str) -> str:
    """Cut a text to 200 characters, for a message."""
    return text if len(text) <= 200 else f"{text[:200]}..."
