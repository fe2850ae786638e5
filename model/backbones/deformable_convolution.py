"""Modulated deformable convolution, DCNv2 (Zhu et al., 2019), with mmdetection's state-dict names."""

import math
from typing import Any

import torch
from torch import Tensor, nn

from ..sampling import sample

NUM_POINTS = 9  # of a 3×3 kernel, row by row


class DeformableConvolution(nn.Module):
    """A 3×3 convolution, padding 1 and no bias, whose points are moved and weighed by what lies under them.

    One offset group. As in mmcv and torchvision, `conv_offset` gives 18 offsets [px], (y, x) point by point, then 9
    logits of the masks; it starts from zeros, which makes half an ordinary convolution.
    """

    def __init__(self, in_channels: int, out_channels: int, stride: int = 1) -> None:
        super().__init__()
        self.stride = stride
        self.weight = nn.Parameter(torch.empty(out_channels, in_channels, 3, 3))
        self.conv_offset = nn.Conv2d(in_channels, 3 * NUM_POINTS, 3, stride=stride, padding=1)
        nn.init.kaiming_uniform_(self.weight, a=math.sqrt(5))  # as nn.Conv2d has it
        nn.init.zeros_(self.conv_offset.weight)
        nn.init.zeros_(self.conv_offset.bias)

    def forward(self, x: Tensor) -> Tensor:
        """x (N, in_channels, H, W); returns (N, out_channels, ⌈H / stride⌉, ⌈W / stride⌉)."""
        offsets, logits = self.conv_offset(x).split((2 * NUM_POINTS, NUM_POINTS), dim=1)
        return deformable_convolution(x, self.weight, offsets, logits.sigmoid(), self.stride)


@torch.library.custom_op("duospacenet::deformable_convolution", mutates_args=())
def deformable_convolution(x: Tensor, weight: Tensor, offsets: Tensor, masks: Tensor, stride: int) -> Tensor:
    """`sample_and_multiply` as one operator of torch, so that a graph may have one node for it."""
    return sample_and_multiply(x, weight, offsets, masks, stride)


def sample_and_multiply(x: Tensor, weight: Tensor, offsets: Tensor, masks: Tensor, stride: int) -> Tensor:
    """DCNv2's equation, y(p) = Σ_k w_k · m_k(p) · x(p + p_k + Δp_k), in plain operators.

    x (N, C, H, W), zeros around it; weight (O, C, 3, 3); offsets Δp (N, 18, H', W') [px], (y, x) point by point;
    masks m (N, 9, H', W'); returns (N, O, H', W'), where H' = ⌈H / stride⌉ and W' likewise.
    """
    samples = sample(x, _sampling_grid(x, offsets, stride))
    weighed = samples.unflatten(2, (NUM_POINTS, -1)) * masks[:, None]
    product = weight.flatten(1) @ weighed.flatten(1, 2).flatten(2)
    return product.unflatten(2, tuple(offsets.shape[-2:]))


def _sampling_grid(x: Tensor, offsets: Tensor, stride: int) -> Tensor:
    """Where to sample, (N, 9·H', W', 2), the points one above the other.

    What is known beforehand is exact and lies around 0, so that float32 is at its finest. At -2 and 2 a sample is zero
    already, whatever the size; onnxruntime's GridSample takes the border for what is far beyond.
    """
    height, width = x.shape[-2:]
    offset_y, offset_x = offsets.unflatten(1, (NUM_POINTS, 2)).unbind(2)
    rows = _twice_from_middle(height, offsets.shape[-2], stride, like=x)
    columns = _twice_from_middle(width, offsets.shape[-1], stride, like=x)
    y = (rows.repeat_interleave(3, dim=0)[:, :, None] + 2 * offset_y) / height
    x = (columns.repeat(3, 1)[:, None, :] + 2 * offset_x) / width
    return torch.stack((x, y), dim=-1).clamp(-2, 2).flatten(1, 2)


def _twice_from_middle(size: int, num_outputs: int, stride: int, like: Tensor) -> Tensor:
    """Twice the way [px] from the middle of a side of `size` px to a kernel's three points (3, num_outputs)."""
    points = torch.arange(-1, 2, dtype=like.dtype, device=like.device)
    centres = stride * torch.arange(num_outputs, dtype=like.dtype, device=like.device)
    return 2 * (points[:, None] + centres) - (size - 1)


@deformable_convolution.register_fake
def _(x: Tensor, weight: Tensor, offsets: Tensor, masks: Tensor, stride: int) -> Tensor:
    return x.new_empty(x.shape[0], weight.shape[0], *offsets.shape[-2:])


def _keep(ctx: Any, inputs: tuple, output: Tensor) -> None:
    *tensors, ctx.stride = inputs
    ctx.save_for_backward(*tensors)


def _backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
    """Through the plain operators, computed once more: nine samples of every pixel are too much to keep."""
    tensors = [tensor.detach().requires_grad_() for tensor in ctx.saved_tensors]
    with torch.enable_grad():
        output = sample_and_multiply(*tensors, ctx.stride)
    return *torch.autograd.grad(output, tensors, gradient), None


deformable_convolution.register_autograd(_backward, setup_context=_keep)
