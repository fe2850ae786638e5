"""Camera images to multi-scale perspective-view (PV) features: normalisation, backbone, feature pyramid."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .backbones.resnet import ResNet
from .backbones.vovnet import VoVNet
from .config import DuoSpaceNetConfig, ImageConfig, VoVNetConfig

NUM_LEVELS = 4


class ImageEncoder(nn.Module):
    """The image encoder of the paper's section "Feature extraction": normalisation, a backbone and a neck."""

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        self.normalisation = Normalisation(config.image)
        backbone = config.backbone
        self.backbone = VoVNet(backbone) if isinstance(backbone, VoVNetConfig) else ResNet(backbone)
        self.neck = FeaturePyramid(self.backbone.out_channels, config.channels)

    def forward(self, images: Tensor) -> list[Tensor]:
        """Convert images (N, H, W, 3) uint8 BGR to F_PV^j (N, C, H_j, W_j) at strides 8, 16, 32 and 64."""
        return self.neck(self.backbone(self.normalisation(images)))

    @property
    def first_convolution(self) -> nn.Conv2d:
        """The convolution that reads the normalised images."""
        return next(module for module in self.backbone.modules() if isinstance(module, nn.Conv2d))


class Normalisation(nn.Module):
    """Brings the pixels of images to the backbone's colour order and scale."""

    mean: Tensor
    std: Tensor

    def __init__(self, config: ImageConfig) -> None:
        super().__init__()
        # The input is always BGR. The backbone expects config.colour_order.
        self.flip_colours = config.colour_order == "rgb"
        self.register_buffer("mean", torch.tensor(config.mean), persistent=False)
        self.register_buffer("std", torch.tensor(config.std), persistent=False)

    def forward(self, images: Tensor) -> Tensor:
        """Convert images (N, H, W, 3) uint8 BGR to (N, 3, H, W) float."""
        # Normalisation is part of the graph, so that its input is uint8: a quarter of the bytes of float32 images.
        pixels = images.float()
        if self.flip_colours:
            pixels = pixels.flip(-1)
        return ((pixels - self.mean) / self.std).permute(0, 3, 1, 2)


class FeaturePyramid(nn.Module):
    """FPN (Lin et al., 2017) on C3..C5. A stride-2 convolution of the third output gives the fourth.

    This is mmdetection's FPN with `add_extra_convs="on_output"` and one extra level, as in Sparse4D and BEVFormer.
    With one extra level, mmdetection's `relu_before_extra_convs` has no effect: it applies from the second one on.
    """

    def __init__(self, in_channels: list[int], channels: int) -> None:
        super().__init__()
        self.lateral = nn.ModuleList(nn.Conv2d(inputs, channels, 1) for inputs in in_channels)
        self.output = nn.ModuleList(nn.Conv2d(channels, channels, 3, padding=1) for _ in in_channels)
        self.extra = nn.Conv2d(channels, channels, 3, stride=2, padding=1)

    def forward(self, features: list[Tensor]) -> list[Tensor]:
        """Convert C3, C4, C5 (N, in_channels[i], H_i, W_i) to four levels (N, channels, H_j, W_j)."""
        merged = [lateral(feature) for lateral, feature in zip(self.lateral, features, strict=True)]
        for fine, coarse in ((1, 2), (0, 1)):
            # By size instead of by a factor of 2: the finer level may have an odd size, such as 25 columns over 13.
            size = merged[fine].shape[-2:]
            merged[fine] = merged[fine] + F.interpolate(merged[coarse], size=size, mode="nearest")
        levels = [output(feature) for output, feature in zip(self.output, merged, strict=True)]
        return [*levels, self.extra(levels[-1])]
