"""A workaround for OpenVINO's int8 mode, which pads an axis of size 1 with a wrong value.

OpenVINO (2026.4) moves a dequantization behind the Pad that follows it. It then pads an axis of size 1 with the integer
0, which stands for `-zero_point · scale`, and not for 0. Longer axes are padded rightly. The level of a feature pyramid
may be one cell high and have such an axis. A concatenation with zeros is the same as the padding, and it is computed
rightly.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from .telemetry import without_openvino_telemetry

with without_openvino_telemetry():
    import openvino
    from openvino import opset15


class _Padding(NamedTuple):
    axis: int
    before: int
    after: int


def replace_pads_of_single_cells(model: "openvino.Model") -> None:
    """Replace each Pad that adds zeros to one axis of size 1 by a concatenation. The model is changed."""
    for node in model.get_ordered_ops():
        if node.get_type_name() == "Pad" and (padding := _padding_of_single_cell(node)):
            _, before, after = padding
            parts = [_zeros(node, padding.axis, before), node.input_value(0), _zeros(node, padding.axis, after)]
            present = [part for part, size in zip(parts, (before, 1, after), strict=True) if size]
            node.output(0).replace(opset15.concat(present, padding.axis).output(0))


def _padding_of_single_cell(node: "openvino.Node") -> _Padding | None:
    """The padding of a Pad node, if it adds zeros to a single axis, and that axis has the size 1."""
    before, after, value = (_constant(node, index) for index in (1, 2, 3))
    if (
        before is None
        or after is None
        or value is None
        or value.any()
        or node.get_attributes()["pad_mode"] != "constant"
    ):
        return None
    axes = np.flatnonzero((before != 0) | (after != 0))
    shape: Sequence[int] = node.input(0).get_shape()
    if len(axes) != 1 or shape[axes[0]] != 1 or before[axes[0]] < 0 or after[axes[0]] < 0:
        return None
    axis = int(axes[0])
    return _Padding(axis, int(before[axis]), int(after[axis]))


def _constant(node: "openvino.Node", index: int) -> np.ndarray | None:
    source = node.input_value(index).get_node()
    return source.data if source.get_type_name() == "Constant" else None


def _zeros(node: "openvino.Node", axis: int, size: int) -> "openvino.Node":
    shape = list(node.input(0).get_shape())
    shape[axis] = size
    return opset15.constant(np.zeros(shape, np.float32), node.input(0).get_element_type())
