"""Parts of tensors by camera: the cameras that a backbone takes at a time, and features without lost cameras."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ..parity.reference import GraphRun
from .deviation import intermediate_error


def worst_group(run: GraphRun, actual: Mapping[str, NDArray], size: int) -> GraphRun:
    """The part of a run of the backbone for the group of cameras with the largest error.

    run: eager mode's inputs and outputs, for the images of all cameras.
    actual: the bundle's outputs for these inputs.
    size: number of cameras that the bundle's backbone takes at a time.
    """

    def cameras(group: int) -> slice:
        return slice(group * size, (group + 1) * size)

    def error(group: int) -> float:
        errors = [
            intermediate_error(name, actual[name][cameras(group)], value[cameras(group)].numpy(), frame=None)
            for name, value in run.outputs.items()
        ]
        return max(each.relative for each in errors)

    worst = cameras(max(range(len(run.inputs["images"]) // size), key=error))
    return GraphRun({"images": run.inputs["images"][worst]}, {name: v[worst] for name, v in run.outputs.items()})


def without_lost_cameras(tensors: Mapping[str, NDArray], camera_valid: NDArray[np.bool_]) -> dict[str, NDArray]:
    """The tensors, with zeros for the features of lost cameras. No graph uses these, and the pipeline may skip them.

    camera_valid (N), or (T, N) if the tensors are those of a window.
    """
    return {
        name: np.where(_of_slot(name, camera_valid)[:, None, None, None], value, 0) if "pv_" in name else value
        for name, value in tensors.items()
    }


def _of_slot(name: str, camera_valid: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The flags (N) of the slot whose cached value has this name."""
    return camera_valid if camera_valid.ndim == 1 else camera_valid[int(name.removeprefix("slot").partition(".")[0])]
