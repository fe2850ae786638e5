"""Activation checkpointing: the backward pass computes activations again, instead of storing them (Chen et al., 2016).

The losses and the gradients are the same, bit for bit on a CPU. A step takes about a third longer.
"""

from functools import partial
from typing import Any

from torch import Tensor, nn
from torch.nn.modules.batchnorm import _BatchNorm
from torch.utils.checkpoint import checkpoint

from ..model.backbones.resnet import BasicBlock, Bottleneck
from ..model.backbones.vovnet import OneShotAggregation, VoVNet
from ..model.bev_encoder import FeatureDivergenceEnhancement
from ..model.bev_fusion import RecurrentStacking, TemporalSelfAttention
from ..model.decoder import DecoderLayer
from ..model.image_encoder import FeaturePyramid
from ..model.segmentation import MapSegmentation

# Blocks and not whole stages: the backward pass holds the activations of one checkpointed module at a time.
CHECKPOINTED = (
    *(BasicBlock, Bottleneck, OneShotAggregation, FeaturePyramid),
    *(FeatureDivergenceEnhancement, RecurrentStacking, TemporalSelfAttention, DecoderLayer, MapSegmentation),
)


def checkpoint_activations(model: nn.Module) -> None:
    """Store only the inputs of the modules of `CHECKPOINTED` in `model`, and of a VoVNet's stem, in place.

    The names in the state dict do not change. BatchNorm statistics are updated once per step, and dropout masks are the
    same in both computations. The checkpoints are non-reentrant, so they work with DistributedDataParallel. Without
    gradient, nothing changes. The model can no longer be exported: save its weights for this.
    """
    for module in model.modules():
        if isinstance(module, CHECKPOINTED):
            _checkpoint(module)
        elif isinstance(module, VoVNet):
            _checkpoint(module.stem)


def has_checkpoints(model: nn.Module) -> bool:
    """Whether `checkpoint_activations` was called with this model."""
    return any("forward" in vars(module) for module in model.modules())


def _checkpoint(module: nn.Module) -> None:
    # On the instance, because a wrapper module would change the names of parameters and hide attributes.
    module.forward = partial(  # type: ignore[method-assign]
        checkpoint, module.forward, use_reentrant=False, context_fn=partial(_contexts, module)
    )


def _contexts(module: nn.Module) -> tuple["_KeptStatistics", "_KeptStatistics"]:
    """The contexts of the first computation, and of the second one in the backward pass."""
    return _KeptStatistics([]), _KeptStatistics([norm for norm in module.modules() if isinstance(norm, _BatchNorm)])


class _KeptStatistics:
    """A context in which BatchNorm layers update copies of their statistics, which are then dropped."""

    def __init__(self, norms: list[_BatchNorm]) -> None:
        self.norms = norms
        self.kept: list[dict[str, Tensor]] = []

    def __enter__(self) -> None:
        self.kept = [dict(norm.named_buffers(recurse=False)) for norm in self.norms]
        for norm, buffers in zip(self.norms, self.kept, strict=True):
            for name, buffer in buffers.items():
                setattr(norm, name, buffer.clone())

    def __exit__(self, *_: Any) -> None:
        for norm, buffers in zip(self.norms, self.kept, strict=True):
            for name, buffer in buffers.items():
                setattr(norm, name, buffer)
