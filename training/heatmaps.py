"""Heatmaps: where objects are, as pictures with a Gaussian peak at each (Law and Deng, 2018; Zhou et al., 2019)."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .initialisation import PRIOR

LEAST_SPREAD_CELLS = 0.7  # what is far and small still has a peak with neighbours


def heatmap_head(channels: int, num_classes: int, num_values: int) -> nn.Sequential:
    """Features (N, C, H, W) to logits of the classes, about PRIOR at first, and behind them other values."""
    hidden = nn.Conv2d(channels, channels, 3, padding=1)
    last = nn.Conv2d(channels, num_classes + num_values, 1)
    assert last.bias is not None
    nn.init.constant_(last.bias[:num_classes], torch.tensor(PRIOR / (1 - PRIOR)).log().item())
    return nn.Sequential(hidden, nn.ReLU(inplace=True), last)


def draw_heatmaps(
    shape: torch.Size, place: tuple[Tensor, Tensor], row: Tensor, column: Tensor, spread: Tensor
) -> Tensor:
    """Heatmaps of shape (N, classes, H, W) with K peaks: a Gaussian each, 1 in its cell; the greatest of several.

    place: of each, which of N (K) and which class (K); row, column (K): its cell; spread (K): the standard deviation
    in cells, LEAST_SPREAD_CELLS where it is less.
    """
    spread = spread.clamp(min=LEAST_SPREAD_CELLS)
    num_classes, height, width = shape[1:]
    rows = torch.arange(height, device=row.device) - row[:, None]
    columns = torch.arange(width, device=row.device) - column[:, None]
    squares = rows[:, :, None] ** 2 + columns[:, None, :] ** 2
    drawn = torch.exp(-squares / (2 * spread[:, None, None] ** 2))
    flat = torch.zeros(shape, device=row.device).view(-1, height * width)
    which = place[0] * num_classes + place[1]
    flat.scatter_reduce_(0, which[:, None].expand(-1, height * width), drawn.flatten(1), "amax")
    return flat.view(shape)


def cells_around(row: Tensor, column: Tensor, height: int, width: int) -> tuple[Tensor, Tensor]:
    """The cells (row and column, K) and the eight round each, as far as they lie on a grid of height×width.

    Returns their numbers, counted along the rows, and which of the K each is around.
    """
    step = torch.arange(-1, 2, device=row.device)
    rows, columns = row[:, None, None] + step[:, None], column[:, None, None] + step
    on_grid = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
    which = torch.arange(len(row), device=row.device)[:, None, None].expand_as(on_grid)
    return (rows * width + columns)[on_grid], which[on_grid]


def least_of_each(cost: Tensor, key: Tensor) -> Tensor:
    """Which of K have the least cost (K) among those of the same key (K), whole numbers from 0 on."""
    least = cost.new_full((int(key.max()) + 1 if len(key) else 0,), torch.inf)
    return cost == least.scatter_reduce(0, key, cost, "amin")[key]


def heatmap_loss(logits: Tensor, targets: Tensor) -> Tensor:
    """CornerNet's focal loss (Law and Deng, 2018, eq. 1), a peak: peaks are 1, round them it matters less."""
    log_score, log_rest = F.logsigmoid(logits), F.logsigmoid(-logits)
    score = log_score.exp()
    is_peak = targets == 1
    at_peaks = torch.where(is_peak, (1 - score) ** 2 * log_score, 0.0)
    elsewhere = torch.where(is_peak, 0.0, (1 - targets) ** 4 * score**2 * log_rest)
    return -(at_peaks + elsewhere).sum() / is_peak.sum().clamp(min=1)
