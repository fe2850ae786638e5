"""The two ONNX forms of deformable sampling: compact, and the plain formula.

The plain formula samples every location in every camera, although a location is visible in about one of six. It has
static shapes only. The compact form lists the locations that are visible in each camera and samples those. The length
of the lists is computed in the graph, so the result is exact for every rig. It samples at the same positions as the
formula, in the same arithmetic.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import onnx_ir
import torch
from onnxscript import opset19

from ..model.deformable_sampling import FAR_OUTSIDE

op: Any = opset19  # its types are those of onnxscript's eager mode
Value = Any  # a tensor of the ONNX graph that is being built

OPERATOR = torch.ops.duospacenet.deformable_sampling.default


def to_compact(
    values: Sequence[Value],
    locations: Value,
    visible: Value,
    offsets: Value | None,
    weights: Value | None,
    num_heads: int,
) -> Value:
    """Translate `OPERATOR` to its compact form, for the exporter's translation table."""
    num_frames, num_cameras, num_queries = visible.shape
    num_levels, channels = len(values) // num_frames, values[0].shape[1]
    num_points = 1 if offsets is None else offsets.shape[4]
    lists = VisibleLists.find(visible)
    grids = _grids(values[:num_levels], lists, locations, offsets)
    masks = None if weights is None else _masks(lists, weights)
    frames = []
    for t in range(num_frames):
        levels = values[t * num_levels : (t + 1) * num_levels]
        samples = [
            _sample(level, grids[j][t], None if masks is None else masks[j][t], num_heads)
            for j, level in enumerate(levels)
        ]
        # The levels are added before the points: one reduction over the points is faster than one per level.
        points = op.Reshape(op.Sum(*samples), _ints(num_cameras, channels, -1, num_points))
        # One row per entry of the lists, and a row of zeros for a location that fewer cameras see than another.
        entries = op.Transpose(op.ReduceSum(points, _ints(3), keepdims=0), perm=[0, 2, 1])
        zeros = op.Constant(value=onnx_ir.tensor([[0.0] * channels], dtype=onnx_ir.DataType.FLOAT))
        rows = op.Concat(op.Reshape(entries, _ints(-1, channels)), zeros, axis=0)
        found = op.Gather(rows, op.Gather(lists.entries, op.Constant(value_int=t), axis=0), axis=0)
        frames.append(op.ReduceSum(found, _ints(0), keepdims=0))
    stacked = op.Concat(*(op.Unsqueeze(frame, _ints(0)) for frame in frames), axis=0)
    return op.Reshape(op.Transpose(stacked, perm=[0, 2, 1]), _ints(num_frames, channels, num_queries))


@dataclass(frozen=True)
class VisibleLists:
    """For each camera of each frame, the locations that are visible in it. All lists have the length M of the longest.

    locations (T·N, M) int64: numbers of locations. used (T·N, M) bool: False where a list is shorter than M.
    entries (T, K, Q) int64: for each location, the list entries that hold it, as camera · M + position. K is the
        largest number of cameras that see a location. N · M stands for no entry.
    shape: T, N and Q.
    """

    locations: Value
    used: Value
    entries: Value
    shape: tuple[int, int, int]

    @classmethod
    def find(cls, visible: Value) -> "VisibleLists":
        """visible (T, N, Q) bool."""
        num_frames, num_cameras, num_queries = visible.shape
        flat = op.Reshape(visible, _ints(-1, num_queries))
        flags = op.Cast(flat, to=onnx_ir.DataType.INT64)
        lengths = op.ReduceSum(flags, _ints(1), keepdims=1)
        length = _at_least_one(op.ReduceMax(lengths, keepdims=0))
        # The lists of all cameras, one after the other. The additional 0 is for unused entries.
        listed = op.Concat(op.Gather(op.NonZero(flat), op.Constant(value_int=1), axis=0), _ints(0), axis=0)
        positions = op.Range(_int(0), length, _int(1))
        used = op.Less(positions, lengths)
        starts = op.CumSum(lengths, _int(0), exclusive=1)
        total = op.ReduceSum(lengths, keepdims=0)
        locations = op.Gather(listed, op.Where(used, op.Add(starts, positions), total), axis=0)
        position_of = op.Reshape(op.Sub(op.CumSum(flags, _int(1)), _ints(1)), _ints(*visible.shape))
        num_visible = op.ReduceSum(op.Reshape(flags, _ints(*visible.shape)), _ints(1), keepdims=0)
        largest = op.Reshape(_at_least_one(op.ReduceMax(num_visible, keepdims=0)), _ints(1))
        sees, cameras = op.TopK(op.Cast(visible, to=onnx_ir.DataType.FLOAT), largest, axis=1)
        entries = op.Add(op.Mul(cameras, length), op.GatherElements(position_of, cameras, axis=1))
        entries = op.Where(op.Greater(sees, _floats(0.5)), entries, op.Mul(length, _ints(num_cameras)))
        return cls(locations, used, entries, (num_frames, num_cameras, num_queries))

    def gather(self, rows: Value, per_camera: bool) -> Value:
        """The rows of the listed locations, (T·N, M, ...).

        rows (T·Q, ...), or (T·N·Q, ...) if `per_camera`: one per location.
        """
        num_frames, num_cameras, num_queries = self.shape
        steps = range(num_frames * num_cameras)
        firsts = [num_queries * (step if per_camera else step // num_cameras) for step in steps]
        return op.Gather(rows, op.Add(self.locations, op.Reshape(_ints(*firsts), _ints(-1, 1))), axis=0)

    def gather_by_level(self, rows: Value, num_heads: int, num_levels: int, size: int) -> Value:
        """The rows (T·Q, heads · L · size) of the listed locations, as (L, T·N, heads, M, size)."""
        num_frames, num_cameras, _ = self.shape
        shape = _ints(num_frames * num_cameras, -1, num_heads, num_levels, size)
        return op.Transpose(op.Reshape(self.gather(rows, per_camera=False), shape), perm=[3, 0, 2, 1, 4])


def _grids(levels: Sequence[Value], lists: VisibleLists, locations: Value, offsets: Value | None) -> list[list[Value]]:
    """The GridSample coordinates [level][frame], (N · heads, M, P, 2)."""
    num_frames, num_cameras, _ = lists.shape
    rows = op.Reshape(op.Transpose(locations, perm=[0, 1, 3, 2]), _ints(-1, 2))
    reference = op.Sub(op.Mul(lists.gather(rows, per_camera=True), _floats(2)), _floats(1))
    reference = op.Where(op.Unsqueeze(lists.used, _ints(2)), reference, _floats(FAR_OUTSIDE))
    if offsets is None:
        frames = _parts(op.Clip(reference, _float(-2), _float(2)), 0, num_frames)
        return [[op.Reshape(frame, _ints(num_cameras, -1, 1, 2)) for frame in frames]] * len(levels)
    num_heads, num_levels, num_points = offsets.shape[2:5]
    # Constants and the reference are repeated to whole rows, because onnxruntime broadcasts short rows slowly.
    cells = [[2 / level.shape[3], 2 / level.shape[2]] * num_points for level in levels] * num_heads
    scale = onnx_ir.tensor([each for row in cells for each in row], onnx_ir.DataType.FLOAT)
    rows = op.Mul(op.Reshape(offsets, _ints(-1, num_heads * num_levels * num_points * 2)), op.Constant(value=scale))
    by_level = lists.gather_by_level(rows, num_heads, num_levels, num_points * 2)
    repeated = op.Unsqueeze(op.Concat(*[reference] * num_points, axis=2), _ints(1))
    grids = op.Clip(op.Add(repeated, by_level), _float(-2), _float(2))
    return _split(grids, num_levels, num_frames, _ints(num_cameras * num_heads, -1, num_points, 2))


def _masks(lists: VisibleLists, weights: Value) -> list[list[Value]]:
    """The attention weights [level][frame], (N · heads, 1, M, P)."""
    num_frames, num_cameras, _ = lists.shape
    num_heads, num_levels, num_points = weights.shape[2:]
    rows = op.Reshape(weights, _ints(-1, num_heads * num_levels * num_points))
    by_level = lists.gather_by_level(rows, num_heads, num_levels, num_points)
    return _split(by_level, num_levels, num_frames, _ints(num_cameras * num_heads, 1, -1, num_points))


def _sample(level: Value, grid: Value, mask: Value | None, num_heads: int) -> Value:
    """Sample a level (N, C, H, W) at all points, times the attention weights: (N · heads, C/heads, M, P)."""
    num_cameras, channels, height, width = level.shape
    heads = op.Reshape(level, _ints(num_cameras * num_heads, channels // num_heads, height, width))
    samples = op.GridSample(heads, grid, mode="bilinear", padding_mode="zeros", align_corners=0)
    return samples if mask is None else op.Mul(samples, mask)


def _split(tensor: Value, num_levels: int, num_frames: int, shape: Value) -> list[list[Value]]:
    """The parts [level][frame] of a tensor (L, T·N, ...), each in `shape`."""
    levels = _parts(tensor, 0, num_levels)
    return [[op.Reshape(part, shape) for part in _parts(level, 1, num_frames)] for level in levels]


def _parts(tensor: Value, axis: int, number: int) -> Sequence[Value]:
    return op.Split(tensor, axis=axis, num_outputs=number) if number > 1 else [tensor]


def _at_least_one(number: Value) -> Value:
    return op.Max(number, _int(1))


def _ints(*values: int) -> Value:
    return op.Constant(value_ints=list(values))


def _int(value: int) -> Value:
    return op.Constant(value_int=value)


def _floats(value: float) -> Value:
    return op.Constant(value_floats=[float(value)])


def _float(value: float) -> Value:
    return op.Constant(value_float=float(value))
