"""The two ONNX forms of deformable sampling: depthwise DeformConv operators, and the formula built on GridSample."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import onnx_ir
import torch
from numpy.typing import NDArray
from onnxscript import opset20

from ..model.deformable_sampling import sample_and_sum

op: Any = opset20  # its types are those of onnxscript's eager mode
Value = Any  # a tensor of the ONNX graph that is being built

OPERATOR = torch.ops.duospacenet.deformable_sampling.default

_FAR_OUTSIDE_PX = -1e6  # no sampling offset leads from here into an image


def to_deform_conv(
    values: Sequence[Value],
    locations: Value,
    visible: Value,
    offsets: Value | None,
    weights: Value | None,
    num_heads: int,
    gap: int,
) -> Value:
    """Translate `OPERATOR` to one DeformConv per level and frame, for the exporter's translation table.

    A depthwise DeformConv with a kernel of ones is a sum of bilinear samples. Its offset groups are the heads, its
    masks the attention weights. Its kernel has a row per sampling point and a column per camera. DeformConv exists
    since opset 19.

    Most cameras do not see a location. So the cameras that see it come first, and the kernel has only as many columns
    as any location needs. This number is computed in the graph, so the result is exact for every rig.
    """
    num_frames, num_cameras, num_queries = visible.shape
    num_levels, num_points = len(values) // num_frames, 1 if offsets is None else offsets.shape[3]
    rows, width = (max(value.shape[axis] for value in values) for axis in (2, 3))
    grid = OutputGrid.choose(num_queries, (num_points, num_cameras), (rows, width))
    seen = _CamerasInOrder.sort(locations, visible)
    kernel_shape = op.Concat(_ints(values[0].shape[1], 1, num_points), seen.number, axis=0)
    kernel = op.Expand(_floats(1.0), kernel_shape)
    sampled: list[list[Value]] = [[] for _ in range(num_frames)]
    for j in range(num_levels):
        frames = values[j::num_levels]
        positions = _split(_relative_positions(frames[0], seen, _level(offsets, j), gap, grid), num_frames, grid)
        masks = _split(_repeat_for_cameras(_level(weights, j), seen), num_frames, grid)
        for t, value in enumerate(frames):
            sampled[t].append(
                op.DeformConv(
                    value,
                    kernel,
                    positions[t],
                    None,
                    masks[t],
                    group=value.shape[1],
                    offset_group=num_heads,
                    strides=grid.strides,
                    pads=grid.pads(value.shape[2], value.shape[3]),
                )
            )
    sums = [op.Reshape(op.Sum(*levels), _ints(1, values[0].shape[1], num_queries)) for levels in sampled]
    return op.Concat(*sums, axis=0)


def decompose(program: torch.export.ExportedProgram) -> torch.export.ExportedProgram:
    """Replace `OPERATOR` by its formula in plain torch operators, for engines that lack DeformConv."""
    if not any(node.target == OPERATOR for node in program.graph.nodes):
        return program
    return program.run_decompositions({OPERATOR: sample_and_sum})


@dataclass(frozen=True)
class OutputGrid:
    """The queries as the output pixels of a DeformConv, R × S.

    DeformConv adds its offsets to a regular grid of positions: point i and camera k of the query in row r and column s
    begin at (i + stride_y · r, k + stride_x · s). So this grid is subtracted from the wanted positions. That rounds
    them, so the grid must not be larger than needed.

    shape: R and S. kernel: the largest kernel, sampling points and cameras. strides: stride_y and stride_x.
    """

    shape: tuple[int, int]
    kernel: tuple[int, int]
    strides: tuple[int, int]

    @classmethod
    def choose(cls, num_queries: int, kernel: tuple[int, int], image: tuple[int, int]) -> "OutputGrid":
        """Choose the grid for images of at most `image`, rows and columns."""
        points, cameras = kernel
        divisors = [s for s in range(1, num_queries + 1) if num_queries % s == 0]
        num_s = min(divisors, key=lambda s: max(num_queries // s, cameras * s))
        num_r = num_queries // num_s
        # With a stride_x of at least the number of cameras, the output has S columns for every width of the kernel.
        strides = _stride(image[0], num_r, points, 1), _stride(image[1], num_s, cameras, cameras)
        return cls((num_r, num_s), kernel, strides)

    def pads(self, rows: int, width: int) -> list[int]:
        """The padding of an image that gives an output of `shape`, at its lower and right border only."""
        sizes = zip(self.shape, self.strides, self.kernel, (rows, width), strict=True)
        # Negative for a single row or column of queries in a larger image, whose stride then leads out of the image.
        return [0, 0, *(max(0, stride * (count - 1) + size - pixels) for count, stride, size, pixels in sizes)]

    def y(self) -> NDArray[np.float32]:
        """The grid's y by sampling point and query, (P, 1, Q)."""
        rows = np.repeat(np.arange(self.shape[0]), self.shape[1]) * self.strides[0]
        return (np.arange(self.kernel[0])[:, None, None] + rows).astype(np.float32)

    def x(self) -> NDArray[np.float32]:
        """The grid's x by camera and query, (N, Q)."""
        columns = np.tile(np.arange(self.shape[1]), self.shape[0]) * self.strides[1]
        return (np.arange(self.kernel[1])[:, None] + columns).astype(np.float32)


@dataclass(frozen=True)
class _CamerasInOrder:
    """The cameras of each location, those that see it first; only as many as the location with the most needs, K.

    number [K] int64. camera (T, K, Q): numbers, as floats. visible (T, K, Q) bool. x, y (T, K, Q): the locations.
    """

    number: Value
    camera: Value
    visible: Value
    x: Value
    y: Value

    @classmethod
    def sort(cls, locations: Value, visible: Value) -> "_CamerasInOrder":
        """locations (T, N, 2, Q) and visible (T, N, Q), of all cameras."""
        x, y = (op.Squeeze(each, _ints(2)) for each in op.Split(locations, axis=2, num_outputs=2))
        if visible.shape[1] == 1:
            return cls(_ints(1), _floats(0.0), visible, x, y)
        num_visible = op.ReduceSum(op.Cast(visible, to=onnx_ir.DataType.INT64), _ints(1), keepdims=0)
        number = op.Reshape(op.Max(op.ReduceMax(num_visible, keepdims=0), op.Constant(value_int=1)), _ints(1))
        first, camera = op.TopK(op.Cast(visible, to=onnx_ir.DataType.FLOAT), number, axis=1)
        return cls(
            number,
            op.Cast(camera, to=onnx_ir.DataType.FLOAT),
            op.Greater(first, _floats(0.5)),
            op.GatherElements(x, camera, axis=1),
            op.GatherElements(y, camera, axis=1),
        )


def _relative_positions(
    level: Value, seen: _CamerasInOrder, offsets: Value | None, gap: int, grid: OutputGrid
) -> Value:
    """The offsets of the DeformConv (T, heads, P, K, 2, Q), y and x, in a level (1, C, N · (H + gap), W).

    offsets (T, heads, P, 2, Q) [cells]: the predicted offsets from the locations.
    """
    rows, width = level.shape[2:]
    height = rows // grid.kernel[1] - gap
    columns = op.Slice(_constant(grid.x()), _ints(0), seen.number, _ints(0))
    x = op.Sub(op.Sub(op.Mul(seen.x, _floats(width)), _floats(0.5)), columns)
    x = op.Unsqueeze(op.Where(seen.visible, x, _floats(_FAR_OUTSIDE_PX)), _ints(1, 2))
    y = op.Unsqueeze(op.Sub(op.Mul(seen.y, _floats(height)), _floats(0.5)), _ints(1, 2))
    if offsets is not None:
        # The axis of x and y, now of length 1, becomes that of the cameras.
        offset_x, offset_y = op.Split(offsets, axis=3, num_outputs=2)
        x, y = op.Add(x, offset_x), op.Add(y, offset_y)
    first_row = op.Unsqueeze(op.Mul(seen.camera, _floats(height + gap)), _ints(1, 2))
    # The clip keeps samples of one camera out of the next. Samples beyond the left and right border are zero anyway.
    y = op.Add(op.Clip(y, _float(-1), _float(height)), op.Sub(first_row, _constant(grid.y())))
    return op.Concat(op.Unsqueeze(y, _ints(-2)), op.Unsqueeze(x, _ints(-2)), axis=-2)


def _repeat_for_cameras(weights: Value | None, seen: _CamerasInOrder) -> Value | None:
    """The masks (T, heads, P, K, Q) from attention weights (T, heads, P, Q)."""
    if weights is None:
        return None
    return op.Expand(op.Unsqueeze(weights, _ints(3)), op.Concat(seen.number, _ints(1), axis=0))


def _level(tensor: Value | None, level: int) -> Value | None:
    """Offsets or weights of one level; the levels are axis 2."""
    return None if tensor is None else op.Gather(tensor, op.Constant(value_int=level), axis=2)


def _split(tensor: Value | None, num_frames: int, grid: OutputGrid) -> list[Value | None]:
    """The channels of a DeformConv input for each frame: (1, channels, R, S)."""
    if tensor is None:
        return [None] * num_frames
    frames = op.Split(tensor, axis=0, num_outputs=num_frames) if num_frames > 1 else [tensor]
    return [op.Reshape(frame, _ints(1, -1, *grid.shape)) for frame in frames]


def _stride(pixels: int, count: int, kernel: int, smallest: int) -> int:
    """The smallest stride with which `count` steps of the kernel cover an axis of the image."""
    return max(smallest, -(-(pixels - kernel) // max(count - 1, 1)), pixels if count == 1 else 1)


def _ints(*values: int) -> Value:
    return op.Constant(value_ints=list(values))


def _floats(value: float) -> Value:
    return op.Constant(value_floats=[float(value)])


def _float(value: float) -> Value:
    return op.Constant(value_float=float(value))


def _constant(values: NDArray[np.float32]) -> Any:
    return op.Constant(value=onnx_ir.tensor(values))
