"""Proof that a graph uses every input it declares: disturb one, and an output must move."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from ...runtime.session import Session, tensors


def dead_inputs(session: Session, inputs: dict[str, NDArray], names: Iterable[str]) -> list[str]:
    """Those of `names` that no output depends on at `inputs`, a typical feed with a full window."""
    before = _outputs(session, inputs)
    return [name for name in names if _same(before, _outputs(session, inputs | {name: disturb(inputs[name])}))]


def disturb(value: NDArray) -> NDArray:
    """Another tensor of the same shape and type, different everywhere, still plausible in size."""
    if value.dtype == np.bool_:
        return ~value
    if value.dtype == np.uint8:
        return 255 - value
    noise = np.random.default_rng(0).uniform(0.05, 0.1, value.shape) * (np.abs(value).max() + 1e-3)
    return (value + noise).astype(value.dtype)


def _outputs(session: Session, inputs: dict[str, NDArray]) -> list[NDArray]:
    return [value.numpy() for value in session.run(tensors(**inputs)).values()]


def _same(before: list[NDArray], after: list[NDArray]) -> bool:
    return all(np.array_equal(a, b) for a, b in zip(before, after, strict=True))
