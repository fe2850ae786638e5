"""The 3D convolutions of feature divergence enhancement, as 2D convolutions of height slices."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ...model import DuoSpaceNet
from ...model.bev_encoder import FeatureDivergenceEnhancement


def slice_heights(model: DuoSpaceNet) -> None:
    """Replace the model's feature divergence enhancement, if it has one, by `SlicedEnhancement`."""
    enhancement = getattr(model, "divergence_enhancement", None)
    if isinstance(enhancement, FeatureDivergenceEnhancement):
        model.divergence_enhancement = SlicedEnhancement(enhancement, model.config.voxels.size[2])


class SlicedEnhancement(nn.Module):
    """Feature divergence enhancement with 2D convolutions only.

    A 3×3×3 convolution at the height z is a 3×3 convolution whose input channels are those of the heights z - 1, z and
    z + 1. onnxruntime has a blocked layout for 2D convolutions, but none for 3D convolutions. The slices stay separate
    until Z is flattened into the channels, so nothing is copied between two layouts.
    """

    def __init__(self, enhancement: FeatureDivergenceEnhancement, num_heights: int) -> None:
        super().__init__()
        # Heights with the same neighbours share their convolution: all but the lowest and the highest.
        neighbours = [tuple(n for n in (-1, 0, 1) if 0 <= z + n < num_heights) for z in range(num_heights)]
        kinds = list(dict.fromkeys(neighbours))
        self.kind_of_height = [kinds.index(each) for each in neighbours]
        self.conv3d = nn.ModuleList(_sliced(block[0], block[1], kinds) for block in enhancement.conv3d)
        self.conv2d = enhancement.conv2d
        first = self.conv2d[0][0]
        # The flattened channels are ordered by height here, and by channel of the voxels there.
        weight = first.weight.unflatten(1, (-1, num_heights)).transpose(1, 2).flatten(1, 2)
        first.weight = nn.Parameter(weight.contiguous(), requires_grad=False)

    def forward(self, voxels: Tensor) -> Tensor:
        """Convert F_voxel (1, voxel_channels, Z, X, Y) to F_BEV (1, C, X, Y)."""
        heights = list(voxels.unbind(dim=2))
        for convolutions in self.conv3d:
            heights = [
                F.relu(convolutions[kind](torch.cat(heights[max(0, z - 1) : z + 2], dim=1)))
                for z, kind in enumerate(self.kind_of_height)
            ]
        return self.conv2d(torch.cat(heights, dim=1))


def _sliced(convolution: nn.Conv3d, norm: nn.BatchNorm3d, kinds: list[tuple[int, ...]]) -> nn.ModuleList:
    """One 2D convolution per kind of height, with the batch norm folded into it. kinds: relative heights it reads."""
    scale = norm.weight.double() / torch.sqrt(norm.running_var.double() + norm.eps)
    weight = convolution.weight.double() * scale[:, None, None, None, None]
    bias = norm.bias.double() - norm.running_mean.double() * scale
    return nn.ModuleList(_convolution([weight[:, :, 1 + n] for n in kind], bias) for kind in kinds)


def _convolution(weights: list[Tensor], bias: Tensor) -> nn.Conv2d:
    """A 3×3 convolution of the channels of several heights. weights: one per height, (out, in, 3, 3)."""
    weight = torch.cat(weights, dim=1).float()
    convolution = nn.Conv2d(weight.shape[1], weight.shape[0], 3, padding=1).requires_grad_(False)
    convolution.weight.copy_(weight)
    assert convolution.bias is not None
    convolution.bias.copy_(bias)
    return convolution
