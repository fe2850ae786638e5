"""Parts of tensors by camera: the cameras that a backbone takes at a time, and features without lost cameras."""

from collections.abc import Mapping
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from ...runtime.camera_groups import STACKED_AXIS
from ..parity.reference import GraphRun
from .deviation import intermediate_error

Stacked = TypeVar("Stacked", Tensor, NDArray)


def worst_group(run: GraphRun, actual: Mapping[str, NDArray], size: int) -> GraphRun:
    """The part of a run of the backbone for the group of cameras with the largest error.

    run: eager mode's inputs and outputs, for the images of all cameras.
    actual: the bundle's outputs for these inputs.
    size: number of cameras that the bundle's backbone takes at a time.
    """
    num_groups = len(run.inputs["images"]) // size

    def error(group: int) -> float:
        parts = {name: _part(value, group, num_groups).numpy() for name, value in run.outputs.items()}
        errors = [
            intermediate_error(name, _part(actual[name], group, num_groups), part, frame=None)
            for name, part in parts.items()
        ]
        return max(each.relative for each in errors)

    group = max(range(num_groups), key=error)
    images = run.inputs["images"][group * size : (group + 1) * size]
    return GraphRun({"images": images}, {name: _part(v, group, num_groups) for name, v in run.outputs.items()})


def without_lost_cameras(tensors: Mapping[str, NDArray], camera_valid: NDArray[np.bool_]) -> dict[str, NDArray]:
    """The tensors, with zeros for the features of lost cameras. No graph uses these, and the pipeline may skip them.

    camera_valid (N), or (T, N) if the tensors are those of a window.
    """
    return {
        name: _blanked(value, camera_valid[_slot(name)] if camera_valid.ndim == 2 else camera_valid)
        if "pv_" in name
        else value
        for name, value in tensors.items()
    }


def _part(stacked: Stacked, group: int, num_groups: int) -> Stacked:
    """The rows of one group of cameras."""
    rows = stacked.shape[STACKED_AXIS] // num_groups
    return stacked[:, :, group * rows : (group + 1) * rows]


def _blanked(stacked: NDArray, camera_valid: NDArray[np.bool_]) -> NDArray:
    rows = np.repeat(camera_valid, stacked.shape[STACKED_AXIS] // len(camera_valid))
    return np.where(rows[:, None], stacked, 0)


def _slot(name: str) -> int:
    return int(name.removeprefix("slot").partition(".")[0])
