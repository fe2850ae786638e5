"""The elements of a graph's inputs: single flags and numbers, and the features of one camera."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ..graphs import Graph

Index = tuple[int | slice, ...]

# The axes along which an input is divided into elements; "" is an axis that stays whole. Other inputs stay whole.
# In the decoder, the first axis of the inputs that are not cached values is the slot.
_AXES = {
    "images": ("camera", "", "", "channel"),
    "image_T_ego": ("camera", "row", "column"),
    "camera_valid": ("camera",),
    "past_T_now": ("row", "column"),
    "voxel_locations": ("camera", "coordinate"),
    "voxel_visible": ("camera",),
}
_PER_CAMERA = ("camera",)  # PV features and PV attention values
# These are constants in slot 0, and the last row of a motion is always the same.
_CONSTANT_IN_SLOT_0 = ("past_T_now", "time_delta_s", "frame_valid")
_CONSTANT_ROW = ("past_T_now", 3)


@dataclass(frozen=True)
class Element:
    """A part of an input that a graph could ignore by itself.

    name: name of the input. index: of the part in the input. place: the part in words, by axis.
    slot, camera: what it belongs to; None for all.
    """

    name: str
    index: Index
    place: str
    slot: int | None
    camera: int | None

    def __str__(self) -> str:
        return f"{self.name}[{self.place}]" if self.place else self.name

    def masks(self, other: "Element") -> bool:
        """Whether `other` has no effect if this element, a flag, is false."""
        if self.name == "frame_valid":
            return self.slot == other.slot
        return self.name == "camera_valid" and (self.slot, self.camera) == (other.slot, other.camera)

    def disturb(self, value: Tensor, generator: torch.Generator) -> None:
        """Change this part of the input `value` in place.

        Flags are negated, and colours inverted. Other numbers change by 5 to 10 % of a typical magnitude, so that they
        stay typical. A large change could have no effect, for example if it moved a camera away from all queries.
        """
        part = value[self.index]
        if value.dtype == torch.bool:
            value[self.index] = ~part
        elif value.dtype == torch.uint8:
            value[self.index] = 255 - part
        else:
            row = value[self.index[:-1]] if self.index and isinstance(self.index[-1], int) else part
            noise = torch.rand(part.shape, generator=generator) * 0.05 + 0.05
            value[self.index] = part + noise * row.abs().mean()


def elements_of(graph: Graph) -> list[Element]:
    """All elements of a graph's inputs, except for those that the contract keeps constant."""
    return [
        element
        for name, spec in graph.inputs.items()
        for element in _elements(name, tuple(spec.shape), of_window=graph.name == "decoder")
        if not (element.name in _CONSTANT_IN_SLOT_0 and element.slot == 0)
    ]


def _elements(name: str, shape: tuple[int, ...], of_window: bool) -> Iterator[Element]:
    slot_prefix, _, base = name.rpartition(".")
    axes = _PER_CAMERA if "pv_" in base else _AXES.get(base, ())
    axes = ("slot", *axes) if of_window and not slot_prefix else axes
    for position in np.ndindex(*(size if axis else 1 for axis, size in zip(axes, shape, strict=False))):
        by_axis = {axis: number for axis, number in zip(axes, position, strict=True) if axis}
        if (name, by_axis.get("row")) == _CONSTANT_ROW:
            continue
        index = tuple(number if axis else slice(None) for axis, number in zip(axes, position, strict=True))
        slot = int(slot_prefix.removeprefix("slot")) if slot_prefix else by_axis.get("slot")
        place = ", ".join(f"{axis} {number}" for axis, number in by_axis.items())
        yield Element(name, index, place, slot, by_axis.get("camera"))
