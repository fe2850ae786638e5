"""Freezing: parts of the model that a training does not change, and BatchNorm layers that keep their statistics."""

from itertools import chain

from ..model import DuoSpaceNet
from ..model.backbones.resnet import ResNet
from ..model.backbones.vovnet import VoVNet
from .batch_norm import fix_statistics
from .settings import Settings

# The modules of each stage. The first stage includes the stem.
_RESNET_STAGES = (("conv1", "bn1", "layer1"), ("layer2",), ("layer3",), ("layer4",))
_VOVNET_STAGES = (("stem", "stage2"), ("stage3",), ("stage4",), ("stage5",))


def freeze(model: DuoSpaceNet, settings: Settings) -> None:
    """Freeze what the settings name, in place. `train` does not undo it.

    `frozen_parts`: the parameters of these parts have no gradient, and their BatchNorm layers keep their statistics.
    `norm_eval`: all BatchNorm layers keep their statistics. Their parameters are trained, if their part is.
    For `frozen_stages` and `backbone_norm_eval` see `freeze_backbone`.

    Call it before the optimiser is made. Parameters without gradient have no weight decay either.
    """
    freeze_backbone(model.image_encoder.backbone, settings)
    for name in settings.frozen_parts:
        fix_statistics(model.get_submodule(name).requires_grad_(False))
    if settings.norm_eval:
        fix_statistics(model)


def freeze_backbone(backbone: ResNet | VoVNet, settings: Settings) -> None:
    """Freeze the parts of the backbone that the settings name, in place, as in mmdetection.

    `frozen_stages`: the parameters of these stages have no gradient, and their BatchNorm layers keep their statistics.
    As in mmdetection (mmdet/models/backbones/resnet.py) and PETR's VoVNetCP, except that 0 freezes nothing.

    `backbone_norm_eval`: all BatchNorm layers keep their statistics, and their parameters have no gradient. As
    mmdetection's `norm_eval=True` with `norm_cfg=dict(type="BN", requires_grad=False)`.
    """
    stages = _VOVNET_STAGES if isinstance(backbone, VoVNet) else _RESNET_STAGES
    frozen = set(chain.from_iterable(stages[: settings.frozen_stages]))
    for name in frozen:
        backbone.get_submodule(name).requires_grad_(False)
    if settings.backbone_norm_eval:
        for norm in fix_statistics(backbone):
            norm.requires_grad_(False)
    else:
        fix_statistics(backbone, frozen)
