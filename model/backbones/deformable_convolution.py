"""Modulated deformable convolution, DCNv2 (Zhu et al., 2019), with mmdetection's state-dict names."""

import math
from typing import Any

import torch
from torch import Tensor, nn

from ..sampling import sample

NUM_POINTS = 9  # of a 3×3 kernel, in row order


class DeformableConvolution(nn.Module):
    """A 3×3 convolution with padding 1 and no bias, with predicted offsets and masks for its sampling points.

    There is one offset group. As in mmcv and torchvision, the channels of `conv_offset` are 18 offsets [px], (y, x)
    for each point, then the logits of 9 masks. It is initialised with zeros. The masks are then 0.5, so the result is
    half that of a normal convolution.
    """

    def __init__(self, in_channels: int, out_channels: int, stride: int = 1) -> None:
        super().__init__()
        self.stride = stride
        self.weight = nn.Parameter(torch.empty(out_channels, in_channels, 3, 3))
        self.conv_offset = nn.Conv2d(in_channels, 3 * NUM_POINTS, 3, stride=stride, padding=1)
        nn.init.kaiming_uniform_(self.weight, a=math.sqrt(5))  # as in nn.Conv2d
        nn.init.zeros_(self.conv_offset.weight)
        nn.init.zeros_(self.conv_offset.bias)

    def forward(self, x: Tensor) -> Tensor:
        """Convolve x (N, in_channels, H, W); returns (N, out_channels, ⌈H / stride⌉, ⌈W / stride⌉)."""
        offsets, logits = self.conv_offset(x).split((2 * NUM_POINTS, NUM_POINTS), dim=1)
        return deformable_convolution(x, self.weight, offsets, logits.sigmoid(), self.stride)


@torch.library.custom_op("duospacenet::deformable_convolution", mutates_args=())
def deformable_convolution(x: Tensor, weight: Tensor, offsets: Tensor, masks: Tensor, stride: int) -> Tensor:
    """`sample_and_multiply` as a single torch operator, so that the export can convert it to a single node."""
    return sample_and_multiply(x, weight, offsets, masks, stride)


def sample_and_multiply(x: Tensor, weight: Tensor, offsets: Tensor, masks: Tensor, stride: int) -> Tensor:
    """The equation of DCNv2 with standard operators: y(p) = Σ_k w_k · m_k(p) · x(p + p_k + Δp_k).

    x (N, C, H, W): padded with zeros.
    weight w (O, C, 3, 3).
    offsets Δp (N, 18, H', W') [px]: (y, x) for each point.
    masks m (N, 9, H', W').

    Returns (N, O, H', W') with H' = ⌈H / stride⌉ and W' = ⌈W / stride⌉.
    """
    # One call for all nine points: onnxruntime's GridSample plans each image once per call, on one thread.
    samples = sample(x, _sampling_grid(x, offsets, stride))
    weighted = samples.unflatten(2, (NUM_POINTS, -1)) * masks[:, None]
    product = weight.flatten(1) @ weighted.flatten(1, 2).flatten(2)
    return product.unflatten(2, tuple(offsets.shape[-2:]))


def _sampling_grid(x: Tensor, offsets: Tensor, stride: int) -> Tensor:
    """The grid_sample coordinates (N, 9·H', W', 2); the grids of the 9 points are stacked vertically."""
    # Twice the distances of the kernel points from the image centre are small integers, which are exact in float32.
    # For huge coordinates onnxruntime (1.31) returns border values. The clamp changes no result: a sample at -2 or 2 is
    # zero for any size.
    height, width = x.shape[-2:]
    offset_y, offset_x = offsets.unflatten(1, (NUM_POINTS, 2)).unbind(2)
    rows = _doubled_positions(height, offsets.shape[-2], stride, like=x)
    columns = _doubled_positions(width, offsets.shape[-1], stride, like=x)
    y = (rows.repeat_interleave(3, dim=0)[:, :, None] + 2 * offset_y) / height
    x = (columns.repeat(3, 1)[:, None, :] + 2 * offset_x) / width
    return torch.stack((x, y), dim=-1).clamp(-2, 2).flatten(1, 2)


def _doubled_positions(size: int, num_outputs: int, stride: int, like: Tensor) -> Tensor:
    """Twice the distance [px] of the three kernel points from the centre of an image of `size` px: (3, num_outputs)."""
    points = torch.arange(-1, 2, dtype=like.dtype, device=like.device)
    centres = stride * torch.arange(num_outputs, dtype=like.dtype, device=like.device)
    return 2 * (points[:, None] + centres) - (size - 1)


@deformable_convolution.register_fake
def _(x: Tensor, weight: Tensor, offsets: Tensor, masks: Tensor, stride: int) -> Tensor:
    return x.new_empty(x.shape[0], weight.shape[0], *offsets.shape[-2:])


def _save_inputs(ctx: Any, inputs: tuple, output: Tensor) -> None:
    *tensors, ctx.stride = inputs
    ctx.save_for_backward(*tensors)


def _backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
    """Compute `sample_and_multiply` again and differentiate it: nine samples per pixel are too many to store."""
    tensors = [tensor.detach().requires_grad_() for tensor in ctx.saved_tensors]
    with torch.enable_grad():
        output = sample_and_multiply(*tensors, ctx.stride)
    return *torch.autograd.grad(output, tensors, gradient), None


deformable_convolution.register_autograd(_backward, setup_context=_save_inputs)
# In mixed precision, the inputs would have different dtypes, and bfloat16 would move the sampling points by pixels.
deformable_convolution.register_autocast("cpu", torch.float32)
deformable_convolution.register_autocast("cuda", torch.float32)
