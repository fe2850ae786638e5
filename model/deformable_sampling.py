"""Deformable sampling: a weighted sum of bilinear samples around locations in several cameras.

It is the core of deformable attention and of lifting. It is one torch operator with a plain formula in grid_sample, so
that the export can convert it to another form that samples only the cameras in which a location is visible.
"""

from typing import Any

import torch
from torch import Tensor

from .sampling import sample

FAR_OUTSIDE = -1e6  # a grid_sample coordinate so far outside that no predicted offset reaches the image


@torch.library.custom_op("duospacenet::deformable_sampling", mutates_args=())
def deformable_sampling(
    values: list[Tensor],
    locations: Tensor,
    visible: Tensor,
    offsets: Tensor | None,
    weights: Tensor | None,
    num_heads: int,
) -> Tensor:
    """`sample_and_sum` as a single torch operator, so that the export can convert it to another form."""
    return sample_and_sum(values, locations, visible, offsets, weights, num_heads)


def sample_and_sum(
    values: list[Tensor],
    locations: Tensor,
    visible: Tensor,
    offsets: Tensor | None,
    weights: Tensor | None,
    num_heads: int,
) -> Tensor:
    """The equation of deformable attention for each frame t: Σ_cameras Σ_levels Σ_points w · v(location + offset).

    values[t · L + j] (N, C, H_j, W_j): level j of frame t. The heads are consecutive groups of channels.
    locations (T, N, 2, Q): x and y as fractions of the image width and height.
    visible (T, N, Q) bool: the sum is only over the cameras in which a location is visible.
    offsets (T, Q, heads, L, P, 2) [cells]: x and y, relative to the location. None for no offset, with P = 1.
    weights (T, Q, heads, L, P): None for weights of one, with P = 1.

    Returns (T, C, Q). Samples outside an image are zero.
    """
    num_levels = len(values) // len(locations)
    reference = _reference_grid(locations, visible)
    grids = reference.clamp(-2, 2)
    levels = []
    for j in range(num_levels):
        frames = values[j::num_levels]
        if offsets is not None:
            grids = _offset_grid(reference, offsets, j, frames[0]).clamp(-2, 2)
        samples = [_sum_over_cameras(frame, grid, num_heads) for frame, grid in zip(frames, grids, strict=True)]
        if weights is not None:
            by_head = weights[..., j, :].permute(0, 2, 3, 1)[:, :, None]
            samples = [each * weight for each, weight in zip(samples, by_head, strict=True)]
        levels.append(torch.stack([each.sum(dim=2).flatten(0, 1) for each in samples]))
    return torch.stack(levels).sum(dim=0)


def _reference_grid(locations: Tensor, visible: Tensor) -> Tensor:
    """The grid_sample coordinates of the locations, (T, N, 1, 1, Q, 2).

    Before sampling they are clamped to [-2, 2]. onnxruntime (1.31) returns border values for huge coordinates, where
    torch returns zeros. At -2 and 2 both return zeros for any level size, so the clamps change no result.
    """
    # In a camera without the location the samples are far outside the image, where they are zero.
    return torch.where(visible[:, :, None], 2 * locations - 1, FAR_OUTSIDE).mT[:, :, None, None]


def _offset_grid(reference: Tensor, offsets: Tensor, j: int, level: Tensor) -> Tensor:
    """The coordinates (T, N, heads, P, Q, 2) of the sampling points in level j.

    reference: from `_reference_grid`. offsets (T, Q, heads, L, P, 2) [cells]. level (..., H_j, W_j).
    """
    height, width = level.shape[-2:]
    cells = torch.stack((offsets[..., j, :, 0] * (2 / width), offsets[..., j, :, 1] * (2 / height)), dim=-1)
    return reference + cells.permute(0, 2, 3, 1, 4)[:, None]


def _sum_over_cameras(level: Tensor, grid: Tensor, num_heads: int) -> Tensor:
    """Sample a level (N, C, H, W) at grid (N, heads or 1, P, Q, 2); returns (heads, C/heads, P, Q)."""
    # Heads become images, because each head has its own sampling points. The split of the channels needs no copy.
    heads = level.reshape(len(level) * num_heads, -1, *level.shape[-2:])
    samples = sample(heads, grid.flatten(0, 1)).unflatten(0, (len(level), num_heads))
    return samples[0] if len(level) == 1 else samples.sum(dim=0)


@deformable_sampling.register_kernel("cuda")
def sample_frames_together(
    values: list[Tensor],
    locations: Tensor,
    visible: Tensor,
    offsets: Tensor | None,
    weights: Tensor | None,
    num_heads: int,
) -> Tensor:
    """`sample_and_sum` with one sampling operation per level for all frames.

    It copies the values. On a GPU that costs less than the launches of separate operations for every frame.
    """
    num_frames, num_cameras = locations.shape[:2]
    num_levels = len(values) // num_frames
    reference = _reference_grid(locations, visible)
    grid = reference.clamp(-2, 2)
    total = values[0].new_zeros(())
    for j in range(num_levels):
        level = torch.stack(values[j::num_levels])
        if offsets is not None:
            grid = _offset_grid(reference, offsets, j, level).clamp(-2, 2)
        heads = level.reshape(num_frames * num_cameras * num_heads, -1, *level.shape[-2:])
        samples = sample(heads, grid.flatten(0, 2)).unflatten(0, (num_frames, num_cameras, num_heads))
        samples = samples.sum(dim=1)
        if weights is not None:
            samples = samples * weights[..., j, :].permute(0, 2, 3, 1)[:, :, None]
        total = total + samples.sum(dim=3).flatten(1, 2)
    return total


@deformable_sampling.register_fake
def _(
    values: list[Tensor],
    locations: Tensor,
    visible: Tensor,
    offsets: Tensor | None,
    weights: Tensor | None,
    num_heads: int,
) -> Tensor:
    return values[0].new_empty(len(locations), values[0].shape[1], locations.shape[-1])


def _save_inputs(ctx: Any, inputs: tuple, output: Tensor) -> None:
    values, *tensors, ctx.num_heads = inputs
    ctx.num_values = len(values)
    ctx.save_for_backward(*values, *tensors)


def _backward(ctx: Any, gradient: Tensor) -> tuple:
    """Compute the operator again and differentiate it: the samples are too many to store."""
    formula = sample_frames_together if gradient.is_cuda else sample_and_sum
    # The values of past frames need no gradient.
    of_values, *of_tensors = ctx.needs_input_grad[:-1]
    needed = [*of_values, *of_tensors]
    saved = [
        each.detach().requires_grad_(need) if each is not None else None
        for each, need in zip(ctx.saved_tensors, needed, strict=True)
    ]
    with torch.enable_grad():
        output = formula(saved[: ctx.num_values], *saved[ctx.num_values :], ctx.num_heads)
    inputs = [each for each, need in zip(saved, needed, strict=True) if need]
    gradients = iter(torch.autograd.grad(output, inputs, gradient))
    results = [next(gradients) if need else None for need in needed]
    return results[: ctx.num_values], *results[ctx.num_values :], None


deformable_sampling.register_autograd(_backward, setup_context=_save_inputs)


def _vmap(info: Any, in_dims: tuple, values: list[Tensor], *arguments: Any) -> tuple[Tensor, int]:
    """The rule for torch.vmap: the frames of all elements of a batch are the frames of one call."""
    size = info.batch_size
    *tensors, num_heads = arguments
    of_values, *of_tensors, _ = in_dims
    by_element = zip(*(_batched(each, dim, size) for each, dim in zip(values, of_values, strict=True)), strict=True)
    merged = [
        None if each is None else _batched(each, dim, size).flatten(0, 1)
        for each, dim in zip(tensors, of_tensors, strict=True)
    ]
    sums = deformable_sampling([level for element in by_element for level in element], *merged, num_heads)
    return sums.unflatten(0, (size, -1)), 0


def _batched(tensor: Tensor, dim: int | None, size: int) -> Tensor:
    """The tensor with the batch as its first axis. dim: the axis of the batch; None for a tensor without one."""
    return tensor.expand(size, *tensor.shape) if dim is None else tensor.movedim(dim, 0)


deformable_sampling.register_vmap(_vmap)
