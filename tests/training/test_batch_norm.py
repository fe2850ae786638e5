"""Tests of BatchNorm in training: the momentum and the average of the statistics over processes."""

from dataclasses import dataclass

import torch
from torch import nn

from duospacenet.training.batch_norm import MOMENTUM, average_batch_norm_statistics, set_batch_norm_momentum
from duospacenet.training.distributed import Processes


@dataclass(frozen=True)
class TwoProcesses(Processes):
    """Two processes, of which the other one has the values 1, 2, 3, ... in all of its statistics."""

    count: int = 2

    def sum(self, tensor):
        return tensor + torch.arange(1.0, len(tensor) + 1)


def test_the_statistics_in_training_are_averaged_over_the_processes():
    model = nn.Sequential(nn.BatchNorm2d(2), nn.Conv2d(2, 1, 1), nn.BatchNorm3d(1), nn.BatchNorm2d(1))
    model[3].eval()
    average_batch_norm_statistics(model, TwoProcesses())
    assert model[0].running_mean.tolist() == [0.5, 1.0]  # (0 + 1) / 2, (0 + 2) / 2
    assert model[0].running_var.tolist() == [2.0, 2.5]  # (1 + 3) / 2, (1 + 4) / 2
    assert (float(model[2].running_mean), float(model[2].running_var)) == (2.5, 3.5)
    assert (float(model[3].running_mean), float(model[3].running_var)) == (0.0, 1.0)


def test_the_statistics_of_parts_that_are_not_trained_are_not_averaged():
    """They are equal in all processes, but the average of three equal numbers may differ by rounding."""
    model = nn.BatchNorm2d(1).requires_grad_(False)
    average_batch_norm_statistics(model, TwoProcesses())
    assert (float(model.running_mean), float(model.running_var)) == (0.0, 1.0)


def test_one_process_keeps_its_statistics():
    model = nn.BatchNorm2d(2)
    average_batch_norm_statistics(model, Processes())
    assert model.running_var.tolist() == [1.0, 1.0]


def test_every_batch_norm_layer_gets_the_momentum():
    model = nn.Sequential(nn.BatchNorm2d(2), nn.BatchNorm3d(2))
    set_batch_norm_momentum(model)
    assert [layer.momentum for layer in model] == [MOMENTUM, MOMENTUM]
