"""ResNet (He et al., 2016), optionally with DCNv2. The state dict has torchvision's names, to load ImageNet weights."""

from collections.abc import Sequence

from torch import Tensor, nn

from ..config import ResNetConfig
from .deformable_convolution import DeformableConvolution


class ResNet(nn.Module):
    """Computes the features C3, C4, C5 of images, at strides 8, 16 and 32."""

    def __init__(self, config: ResNetConfig) -> None:
        super().__init__()
        block = BLOCKS[config.block]
        widths = [config.width * 2**stage for stage in range(4)]
        self.conv1 = nn.Conv2d(3, config.width, 7, stride=2, padding=3, bias=False)
        self.bn1 = nn.BatchNorm2d(config.width, eps=config.batch_norm_eps)
        self.relu = nn.ReLU(inplace=True)
        self.maxpool = nn.MaxPool2d(3, stride=2, padding=1)
        inputs = [config.width] + [width * block.expansion for width in widths[:3]]
        stages = [
            _stage(
                DeformableBottleneck if i + 1 in config.deformable_stages else block,
                *(inputs[i], widths[i]),
                depth=config.depths[i],
                stride=1 if i == 0 else 2,
                config=config,
            )
            for i in range(4)
        ]
        self.layer1, self.layer2, self.layer3, self.layer4 = stages
        self.out_channels = [width * block.expansion for width in widths[1:]]

    def forward(self, images: Tensor) -> list[Tensor]:
        """Convert normalised images (N, 3, H, W) to C3, C4, C5 (N, out_channels[i], ⌈H / stride⌉, ⌈W / stride⌉)."""
        c1 = self.maxpool(self.relu(self.bn1(self.conv1(images))))
        c2 = self.layer1(c1)
        c3 = self.layer2(c2)
        c4 = self.layer3(c3)
        return [c3, c4, self.layer4(c4)]


class BasicBlock(nn.Module):
    """Two 3×3 convolutions with a residual connection."""

    expansion = 1

    def __init__(self, in_channels: int, width: int, stride: int, config: ResNetConfig) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(in_channels, width, 3, stride=stride, padding=1, bias=False)
        self.bn1 = nn.BatchNorm2d(width, eps=config.batch_norm_eps)
        self.conv2 = nn.Conv2d(width, width, 3, padding=1, bias=False)
        self.bn2 = nn.BatchNorm2d(width, eps=config.batch_norm_eps)
        self.relu = nn.ReLU(inplace=True)
        self.downsample = _downsample(in_channels, width, stride, config)

    def forward(self, x: Tensor) -> Tensor:
        out = self.relu(self.bn1(self.conv1(x)))
        out = self.bn2(self.conv2(out))
        return self.relu(out + self.downsample(x))


class Bottleneck(nn.Module):
    """1×1, 3×3 and 1×1 convolutions with a residual connection.

    The 3×3 convolution has the stride; in caffe style, the first 1×1 convolution has it.
    """

    expansion = 4

    def __init__(self, in_channels: int, width: int, stride: int, config: ResNetConfig) -> None:
        super().__init__()
        first, second = (stride, 1) if config.caffe_style else (1, stride)
        self.conv1 = nn.Conv2d(in_channels, width, 1, stride=first, bias=False)
        self.bn1 = nn.BatchNorm2d(width, eps=config.batch_norm_eps)
        self.conv2 = self.convolution(width, second)
        self.bn2 = nn.BatchNorm2d(width, eps=config.batch_norm_eps)
        self.conv3 = nn.Conv2d(width, width * self.expansion, 1, bias=False)
        self.bn3 = nn.BatchNorm2d(width * self.expansion, eps=config.batch_norm_eps)
        self.relu = nn.ReLU(inplace=True)
        self.downsample = _downsample(in_channels, width * self.expansion, stride, config)

    @staticmethod
    def convolution(width: int, stride: int) -> nn.Module:
        """The 3×3 convolution."""
        return nn.Conv2d(width, width, 3, stride=stride, padding=1, bias=False)

    def forward(self, x: Tensor) -> Tensor:
        out = self.relu(self.bn1(self.conv1(x)))
        out = self.relu(self.bn2(self.conv2(out)))
        out = self.bn3(self.conv3(out))
        return self.relu(out + self.downsample(x))


class DeformableBottleneck(Bottleneck):
    """A bottleneck with a DCNv2 as its 3×3 convolution, also for stride 2, as in mmdetection's `stage_with_dcn`."""

    @staticmethod
    def convolution(width: int, stride: int) -> nn.Module:
        return DeformableConvolution(width, width, stride)


BLOCKS: dict[str, type[BasicBlock] | type[Bottleneck]] = {"basic": BasicBlock, "bottleneck": Bottleneck}


def _stage(
    block: type[BasicBlock] | type[Bottleneck],
    in_channels: int,
    width: int,
    depth: int,
    stride: int,
    config: ResNetConfig,
) -> nn.Sequential:
    inputs: Sequence[int] = [in_channels] + [width * block.expansion] * (depth - 1)
    return nn.Sequential(
        *(block(channels, width, stride if i == 0 else 1, config) for i, channels in enumerate(inputs))
    )


def _downsample(in_channels: int, out_channels: int, stride: int, config: ResNetConfig) -> nn.Module:
    if stride == 1 and in_channels == out_channels:
        return nn.Identity()
    return nn.Sequential(
        nn.Conv2d(in_channels, out_channels, 1, stride=stride, bias=False),
        nn.BatchNorm2d(out_channels, eps=config.batch_norm_eps),
    )
