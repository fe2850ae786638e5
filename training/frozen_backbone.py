"""Freezing parts of the backbone: its first stages, and its BatchNorm layers, as in mmdetection."""

from itertools import chain

from torch import nn

from ..model.backbones.resnet import ResNet
from ..model.backbones.vovnet import VoVNet
from .settings import Settings

# The modules of each stage. The first stage includes the stem.
_RESNET_STAGES = (("conv1", "bn1", "layer1"), ("layer2",), ("layer3",), ("layer4",))
_VOVNET_STAGES = (("stem", "stage2"), ("stage3",), ("stage4",), ("stage5",))


def freeze_backbone(backbone: ResNet | VoVNet, settings: Settings) -> None:
    """Freeze the parts of the backbone that the settings name, in place. `train` does not undo it.

    `frozen_stages`: the parameters of these stages have no gradient, and their BatchNorm layers stay in evaluation
    mode. As in mmdetection (mmdet/models/backbones/resnet.py) and PETR's VoVNetCP, except that 0 freezes nothing.

    `backbone_norm_eval`: all BatchNorm layers stay in evaluation mode, and their parameters have no gradient. As
    mmdetection's `norm_eval=True` with `norm_cfg=dict(type="BN", requires_grad=False)`.

    Call it before the optimiser is made. Parameters without gradient have no weight decay either.
    """
    stages = _VOVNET_STAGES if isinstance(backbone, VoVNet) else _RESNET_STAGES
    frozen = set(chain.from_iterable(stages[: settings.frozen_stages]))
    for name in frozen:
        backbone.get_submodule(name).requires_grad_(False)
    for name, module in list(backbone.named_modules()):
        is_frozen = settings.backbone_norm_eval or name.partition(".")[0] in frozen
        if is_frozen and isinstance(module, nn.BatchNorm2d):
            backbone.set_submodule(name, FrozenBatchNorm2d.from_norm(module))


class FrozenBatchNorm2d(nn.BatchNorm2d):
    """A BatchNorm2d that stays in evaluation mode: it does not update its running statistics.

    Its parameters have no gradient. The state dict has the names of nn.BatchNorm2d.
    """

    @classmethod
    def from_norm(cls, norm: nn.BatchNorm2d) -> "FrozenBatchNorm2d":
        """The frozen form of `norm`, with the same parameters and buffers."""
        frozen = cls(norm.num_features, eps=norm.eps, momentum=norm.momentum)
        frozen.weight, frozen.bias = norm.weight, norm.bias
        frozen.running_mean, frozen.running_var = norm.running_mean, norm.running_var
        frozen.num_batches_tracked = norm.num_batches_tracked
        return frozen.requires_grad_(False).eval()

    def train(self, mode: bool = True) -> "FrozenBatchNorm2d":
        """Stay in evaluation mode, whatever `mode` says."""
        return super().train(False)
