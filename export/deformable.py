"""The two ONNX forms of a deformable convolution: the DeformConv operator, and a formula built on GridSample."""

import torch
from onnxscript import opset20 as op
from onnxscript.onnx_types import FLOAT

from ..model.backbones.deformable_convolution import sample_and_multiply

OPERATOR = torch.ops.duospacenet.deformable_convolution.default


def to_deform_conv(x: FLOAT, weight: FLOAT, offsets: FLOAT, masks: FLOAT, stride: int) -> FLOAT:
    """Translate `OPERATOR` to one DeformConv node, for the exporter's translation table.

    DeformConv exists since opset 19. It orders the offsets as torchvision does, so they need no conversion.
    """
    return op.DeformConv(
        x, weight, offsets, None, masks, kernel_shape=[3, 3], strides=[stride, stride], pads=[1, 1, 1, 1]
    )


def decompose(program: torch.export.ExportedProgram) -> torch.export.ExportedProgram:
    """Replace `OPERATOR` by its formula in plain torch operators, for engines that lack DeformConv."""
    if not any(node.target == OPERATOR for node in program.graph.nodes):
        return program
    return program.run_decompositions({OPERATOR: sample_and_multiply})
