"""BatchNorm in training: the momentum of its running statistics, and their average over processes."""

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
