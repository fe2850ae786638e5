"""Deformable sampling: a weighted sum of bilinear samples, around locations in stacked cameras.

It is the core of PV attention, BEV attention and lifting. It is one torch operator with a plain formula in grid_sample,
so that the export can convert it to another ONNX operator.
"""

from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from .sampling import sample

FAR_OUTSIDE_PX = -2.0  # x of an invisible location: samples left of -1 are zero


def stack_cameras(features: Tensor) -> Tensor:
    """Stack the cameras of a level below each other in one image, with a row of zeros after each.

    features (N, C, H, W); returns (1, C, N · (H + 1), W).

    onnxruntime samples one image at a time. The rows of zeros keep bilinear samples from mixing two cameras.
    """
    return F.pad(features, (0, 0, 0, 1)).transpose(0, 1).flatten(1, 2)[None]


@torch.library.custom_op("duospacenet::deformable_sampling", mutates_args=())
def deformable_sampling(
    values: list[Tensor],
    locations: Tensor,
    visible: Tensor,
    offsets: Tensor | None,
    weights: Tensor | None,
    num_heads: int,
    gap: int,
) -> Tensor:
    """`sample_and_sum` as a single torch operator, so that the export can convert it to another ONNX operator."""
    return sample_and_sum(values, locations, visible, offsets, weights, num_heads, gap)


def sample_and_sum(
    values: list[Tensor],
    locations: Tensor,
    visible: Tensor,
    offsets: Tensor | None,
    weights: Tensor | None,
    num_heads: int,
    gap: int,
) -> Tensor:
    """The equation of deformable attention for each frame t: Σ_cameras Σ_levels Σ_points w · v(location + offset).

    values[t · L + j] (1, C, N · (H_j + gap), W_j): level j of frame t, with the cameras stacked. The heads are
        consecutive groups of channels.
    locations (T, N, 2, Q): x and y as fractions of the image width and height.
    visible (T, N, Q) bool: the sum is only over the cameras in which a location is visible.
    offsets (T, heads, L, P, 2, Q) [cells]: x and y, relative to the location. None for no offset, with P = 1.
    weights (T, heads, L, P, Q): None for weights of one, with P = 1.
    gap: rows of zeros after each camera, at least 1 if there are several cameras.

    Returns (T, C, Q). Samples outside a camera's image are zero.
    """
    num_levels = len(values) // len(locations)
    levels = []
    for j in range(num_levels):
        frames = values[j::num_levels]
        grids = _grids(frames[0], locations, visible, None if offsets is None else offsets[:, :, j], gap)
        samples = [_sum_over_cameras(frame, grid, num_heads) for frame, grid in zip(frames, grids, strict=True)]
        if weights is not None:
            samples = [each * weights[t, :, None, j] for t, each in enumerate(samples)]
        levels.append(torch.stack([each.sum(dim=2).flatten(0, 1) for each in samples]))
    return torch.stack(levels).sum(dim=0)


def _grids(level: Tensor, locations: Tensor, visible: Tensor, offsets: Tensor | None, gap: int) -> Tensor:
    """The grid_sample coordinates (T, heads, N, P, Q, 2) of a level (1, C, N · (H + gap), W).

    offsets (T, heads, P, 2, Q) [cells].
    """
    (rows, width), num_cameras = level.shape[-2:], locations.shape[1]
    height = rows // num_cameras - gap
    # Positions in cells, from the centre of the first cell.
    x, y = locations[:, None, :, None].unbind(dim=-2)
    x, y = x * width - 0.5, y * height - 0.5
    if offsets is not None:
        x, y = x + offsets[:, :, None, :, 0], y + offsets[:, :, None, :, 1]
    # onnxruntime (1.31) returns border values for huge coordinates, where torch returns zeros. The clamp changes no
    # sample: at -1, at the width and at the height both return zeros.
    x = torch.where(visible[:, None, :, None], x, FAR_OUTSIDE_PX).clamp(FAR_OUTSIDE_PX, width + 1.0)
    cameras = torch.arange(num_cameras, dtype=y.dtype, device=y.device)[:, None, None]
    # With a single camera, two cells outside instead of one: rounding then leads to no sample inside.
    outside = 1.0 if gap else 2.0
    y = y.clamp(-outside, height - 1 + outside) + cameras * (height + gap)
    return torch.stack(((2 * x + 1) / width - 1, (2 * y + 1) / rows - 1), dim=-1)


def _sum_over_cameras(level: Tensor, grid: Tensor, num_heads: int) -> Tensor:
    """Sample a level (1, C, rows, W) at grid (heads, N, P, Q, 2); returns (heads, C/heads, P, Q)."""
    # Heads become images, because each head has its own sampling points. The split of the channels needs no copy.
    heads = level.reshape(num_heads, -1, *level.shape[-2:])
    samples = sample(heads, grid.flatten(1, 2))
    return samples.unflatten(2, grid.shape[1:3]).sum(dim=2)


@deformable_sampling.register_fake
def _(
    values: list[Tensor],
    locations: Tensor,
    visible: Tensor,
    offsets: Tensor | None,
    weights: Tensor | None,
    num_heads: int,
    gap: int,
) -> Tensor:
    return values[0].new_empty(len(locations), values[0].shape[1], locations.shape[-1])


def _save_inputs(ctx: Any, inputs: tuple, output: Tensor) -> None:
    values, *tensors, ctx.num_heads, ctx.gap = inputs
    ctx.num_values = len(values)
    ctx.save_for_backward(*values, *tensors)


def _backward(ctx: Any, gradient: Tensor) -> tuple:
    """Compute `sample_and_sum` again and differentiate it: the samples are too many to store."""
    # The values of past frames need no gradient.
    of_values, *of_tensors = ctx.needs_input_grad[:-2]
    needed = [*of_values, *of_tensors]
    saved = [
        each.detach().requires_grad_(need) if each is not None else None
        for each, need in zip(ctx.saved_tensors, needed, strict=True)
    ]
    with torch.enable_grad():
        output = sample_and_sum(saved[: ctx.num_values], *saved[ctx.num_values :], ctx.num_heads, ctx.gap)
    inputs = [each for each, need in zip(saved, needed, strict=True) if need]
    gradients = iter(torch.autograd.grad(output, inputs, gradient))
    results = [next(gradients) if need else None for need in needed]
    return results[: ctx.num_values], *results[ctx.num_values :], None, None


deformable_sampling.register_autograd(_backward, setup_context=_save_inputs)
