"""Tests of the heatmaps and their loss, against loops over the equations."""

import math

import pytest
import torch

from duospacenet.training.losses.heatmaps import draw_heatmaps, heatmap_head, heatmap_loss, neighbouring_cells

SHAPE = torch.Size((2, 3, 6, 9))


def heatmaps_of(*peaks):
    """Heatmaps with peaks (index in N, class, row, column, spread)."""
    index, label, row, column, spread = (torch.tensor(values) for values in zip(*peaks, strict=True))
    return draw_heatmaps(SHAPE, (index, label), row, column, spread)


def test_a_peak_is_a_gaussian_in_its_own_map_only():
    heatmaps = heatmaps_of((1, 2, 4, 3, 1.5))
    for row in range(6):
        for column in range(9):
            expected = math.exp(-((row - 4) ** 2 + (column - 3) ** 2) / (2 * 1.5**2))
            assert float(heatmaps[1, 2, row, column]) == pytest.approx(expected, rel=1e-5)
    assert heatmaps[1, 2, 4, 3] == 1
    assert not heatmaps[0].any()
    assert not heatmaps[1, :2].any()


def test_overlapping_peaks_of_a_map_give_the_maximum_and_peaks_of_other_maps_do_not_matter():
    one, other = (0, 1, 2, 3, 1.0), (0, 1, 3, 5, 2.0)
    assert torch.equal(heatmaps_of(one, other), torch.maximum(heatmaps_of(one), heatmaps_of(other)))
    assert torch.equal(heatmaps_of(one, (0, 2, 3, 5, 2.0))[0, 1], heatmaps_of(one)[0, 1])


def test_heatmaps_without_objects_are_zero():
    empty = torch.zeros(0, dtype=torch.long)
    assert not draw_heatmaps(SHAPE, (empty, empty), empty, empty, torch.zeros(0)).any()


def test_a_cell_has_nine_neighbouring_cells_including_itself_and_fewer_at_the_border():
    """On a grid of 6x9: around (3, 5), and around the corner (0, 8)."""
    cell, index = neighbouring_cells(torch.tensor([3, 0]), torch.tensor([5, 8]), 6, 9)
    middle = [row * 9 + column for row in (2, 3, 4) for column in (4, 5, 6)]
    assert cell.tolist() == [*middle, 7, 8, 9 + 7, 9 + 8]
    assert index.tolist() == [0] * 9 + [1] * 4


def test_the_heatmap_loss_follows_the_equation_of_cornernet():
    """Law and Deng, 2018, eq. 1, with α = 2 and β = 4, cell by cell in float64."""
    generator = torch.Generator().manual_seed(0)
    logits = torch.randn(2, 3, 4, 5, generator=generator) * 2
    targets = torch.rand(2, 3, 4, 5, generator=generator)
    targets[0, 1, 2, 3] = targets[1, 0, 0, 0] = 1.0
    total = 0.0
    for logit, target in zip(logits.flatten().tolist(), targets.flatten().tolist(), strict=True):
        score = 1 / (1 + math.exp(-logit))
        if target == 1:
            total -= (1 - score) ** 2 * math.log(score)
        else:
            total -= (1 - target) ** 4 * score**2 * math.log(1 - score)
    assert float(heatmap_loss(logits, targets)) == pytest.approx(total / 2, rel=1e-5)


def test_the_heatmap_loss_without_peaks_is_the_sum_over_the_cells():
    assert float(heatmap_loss(torch.zeros(1, 1, 2, 2), torch.zeros(1, 1, 2, 2))) == pytest.approx(math.log(2))


def test_a_new_heatmap_head_gives_class_scores_of_about_0_01_and_small_other_values():
    maps = heatmap_head(8, 3, 2)(torch.zeros(1, 8, 5, 5))
    assert maps.shape == (1, 5, 5, 5)
    assert maps[:, :3].sigmoid().mean().item() == pytest.approx(0.01, rel=0.2)
    assert maps[:, 3:].abs().max() < 1
