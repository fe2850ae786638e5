"""Map segmentation on the BEV features: a small U-Net and one head per map class (paper, "Multi-Task Learning")."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .config import DuoSpaceNetConfig


class MapSegmentation(nn.Module):
    """Computes a mask of logits for each map class from F_BEV."""

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        width = config.segmentation_channels
        self.enter = _block(config.channels, width)
        self.down = nn.ModuleList((_block(width, 2 * width), _block(2 * width, 4 * width)))
        self.up = nn.ModuleList((_block(6 * width, 2 * width), _block(3 * width, width)))
        self.heads = nn.ModuleDict({name: _head(width) for name in config.map_classes})

    def forward(self, bev: Tensor) -> dict[str, Tensor]:
        """Convert F_BEV (1, C, X, Y), with X and Y divisible by 4, to logits (1, 1, X, Y) by map class."""
        fine = self.enter(bev)
        middle = self.down[0](F.max_pool2d(fine, 2))
        coarse = self.down[1](F.max_pool2d(middle, 2))
        middle = self.up[0](torch.cat((_enlarge(coarse), middle), dim=1))
        fine = self.up[1](torch.cat((_enlarge(middle), fine), dim=1))
        return {name: head(fine) for name, head in self.heads.items()}


def _enlarge(features: Tensor) -> Tensor:
    """Double the height and the width of features (1, channels, H, W)."""
    return F.interpolate(features, scale_factor=2.0, mode="nearest")


def _block(in_channels: int, out_channels: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(in_channels, out_channels, 3, padding=1, bias=False),
        nn.BatchNorm2d(out_channels),
        nn.ReLU(inplace=True),
        nn.Conv2d(out_channels, out_channels, 3, padding=1, bias=False),
        nn.BatchNorm2d(out_channels),
        nn.ReLU(inplace=True),
    )


def _head(channels: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(channels, channels, 3, padding=1, bias=False),
        nn.BatchNorm2d(channels),
        nn.ReLU(inplace=True),
        nn.Conv2d(channels, 1, 1),
    )
