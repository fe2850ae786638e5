"""Find inputs of a graph that no output depends on, by changing one input at a time."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from ...runtime.bundle.manifest import slot_name
from ...runtime.session import Session, to_tensors


def unused_inputs(session: Session, inputs: dict[str, NDArray], names: Iterable[str]) -> list[str]:
    """The inputs among `names` that have no effect on any output.

    inputs: typical values of all inputs. For the decoder, every slot of the window must hold a frame, because the
        values of masked slots have no effect.
    """
    before = _outputs(session, inputs)
    return [name for name in names if _equal(before, _outputs(session, inputs | {name: disturb(inputs[name])}))]


def fill_empty_slots(inputs: dict[str, NDArray]) -> dict[str, NDArray]:
    """A copy of the decoder's inputs in which every empty slot holds the values of the current frame."""
    filled = {name: value.copy() for name, value in inputs.items()}
    for slot in np.flatnonzero(~inputs["frame_valid"]).tolist():
        for name, value in filled.items():
            if name.startswith(slot_name(slot, "")):
                filled[name] = inputs[slot_name(0, name.split(".", 1)[1])]
            elif not name.startswith("slot"):
                value[slot] = inputs[name][0]
    return filled


def disturb(value: NDArray) -> NDArray:
    """A tensor of the same shape and type that differs in every element, by 5 to 10 % of the largest magnitude."""
    if value.dtype == np.bool_:
        return ~value
    if value.dtype == np.uint8:
        return 255 - value
    # A small change keeps the values typical. A large one could have no effect, for example if it moved all sampling
    # points out of the images.
    noise = np.random.default_rng(0).uniform(0.05, 0.1, value.shape) * (np.abs(value).max() + 1e-3)
    return (value + noise).astype(value.dtype)


def _outputs(session: Session, inputs: dict[str, NDArray]) -> list[NDArray]:
    return [value.numpy() for value in session.run(to_tensors(**inputs)).values()]


def _equal(before: list[NDArray], after: list[NDArray]) -> bool:
    return all(np.array_equal(a, b) for a, b in zip(before, after, strict=True))
