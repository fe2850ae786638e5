"""BatchNorm in training: its running statistics, which are averaged over steps and processes, or fixed."""

from collections.abc import Collection

import torch
from torch import Tensor, nn
from torch.nn.modules.batchnorm import _BatchNorm

from .distributed import Processes

# A step has few frames, so the running statistics of BatchNorm are averaged over about a hundred steps.
MOMENTUM = 0.01


def set_batch_norm_momentum(model: nn.Module) -> None:
    """Set the momentum of all BatchNorm layers to MOMENTUM, in place."""
    for module in model.modules():
        if isinstance(module, _BatchNorm):
            module.momentum = MOMENTUM


@torch.no_grad()
def average_batch_norm_statistics(model: nn.Module, processes: Processes) -> None:
    """Replace the running statistics that are in training by their average over all processes, in place.

    The averages of all processes are equal bit for bit.
    """
    statistics = running_statistics(model)
    if processes.count == 1 or not statistics:
        return
    # One exchange for all layers, because each exchange waits for the slowest process.
    flat = torch.cat([tensor.flatten() for tensor in statistics])
    average = processes.sum(flat) / processes.count
    for tensor, values in zip(statistics, average.split([tensor.numel() for tensor in statistics]), strict=True):
        tensor.copy_(values.view_as(tensor))


def running_statistics(model: nn.Module) -> list[Tensor]:
    """The means and variances of the BatchNorm layers that are trained.

    Those of layers without gradient, in parts that are not trained, never change, and an average would round them.
    """
    norms = [module for module in model.modules() if isinstance(module, _BatchNorm) and module.training]
    norms = [norm for norm in norms if norm.weight.requires_grad]
    return [tensor for norm in norms for tensor in (norm.running_mean, norm.running_var) if isinstance(tensor, Tensor)]


class FixedStatistics(_BatchNorm):
    """A BatchNorm layer that stays in evaluation mode: it normalises with its running statistics and keeps them."""

    @classmethod
    def from_norm(cls, norm: _BatchNorm) -> "FixedStatistics":
        """The same layer with fixed statistics. It has the parameters and the buffers of `norm`, not copies."""
        fixed = cls(norm.num_features, eps=norm.eps, momentum=norm.momentum)
        fixed.weight, fixed.bias = norm.weight, norm.bias
        fixed.running_mean, fixed.running_var = norm.running_mean, norm.running_var
        fixed.num_batches_tracked = norm.num_batches_tracked
        return fixed.eval()

    def train(self, mode: bool = True) -> "FixedStatistics":
        """Stay in evaluation mode, whatever `mode` says."""
        return super().train(False)


class FixedBatchNorm2d(FixedStatistics, nn.BatchNorm2d):
    """BatchNorm2d with fixed statistics."""


class FixedBatchNorm3d(FixedStatistics, nn.BatchNorm3d):
    """BatchNorm3d with fixed statistics."""


def fix_statistics(module: nn.Module, parts: Collection[str] | None = None) -> list[FixedStatistics]:
    """Replace BatchNorm layers within a module by layers with fixed statistics, in place. Returns the new layers.

    parts: the names of the children of `module` whose layers are replaced; None = all.

    The names in the state dict stay the same.
    """
    fixed: list[FixedStatistics] = []
    for name, norm in list(module.named_modules()):
        if isinstance(norm, _BatchNorm) and (parts is None or name.partition(".")[0] in parts):
            kind = FixedBatchNorm3d if isinstance(norm, nn.BatchNorm3d) else FixedBatchNorm2d
            fixed.append(kind.from_norm(norm))
            module.set_submodule(name, fixed[-1])
    return fixed
