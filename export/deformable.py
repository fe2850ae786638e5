"""The form of a deformable convolution for onnxruntime: the operator DeformConv."""

import torch
from onnxscript import opset19 as op
from onnxscript.onnx_types import FLOAT

OPERATOR = torch.ops.duospacenet.deformable_convolution.default


def to_deform_conv(x: FLOAT, weight: FLOAT, offsets: FLOAT, masks: FLOAT, stride: int) -> FLOAT:
    """Translate `OPERATOR` to one DeformConv node, for the exporter's translation table.

    DeformConv exists since opset 19. It orders the offsets as torchvision does, so they need no conversion.
    """
    return op.DeformConv(
        x, weight, offsets, None, masks, kernel_shape=[3, 3], strides=[stride, stride], pads=[1, 1, 1, 1]
    )
