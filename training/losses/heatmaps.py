"""Heatmaps of object centres, with one Gaussian peak per object (Law and Deng, 2018; Zhou et al., 2019)."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ..initialisation import PRIOR

MIN_SPREAD_CELLS = 0.7  # so that the peak of a small object still covers the neighbouring cells


def heatmap_head(channels: int, num_classes: int, num_values: int) -> nn.Sequential:
    """Two convolutions from features (N, channels, H, W) to (N, num_classes + num_values, H, W).

    The first channels are class logits, with an initial score of about PRIOR. The others are the values that a head
    regresses in every cell.
    """
    hidden = nn.Conv2d(channels, channels, 3, padding=1)
    last = nn.Conv2d(channels, num_classes + num_values, 1)
    assert last.bias is not None
    nn.init.constant_(last.bias[:num_classes], torch.tensor(PRIOR / (1 - PRIOR)).log().item())
    return nn.Sequential(hidden, nn.ReLU(inplace=True), last)


def draw_heatmaps(
    shape: torch.Size, channel: tuple[Tensor, Tensor], row: Tensor, column: Tensor, spread: Tensor
) -> Tensor:
    """Draw K Gaussian peaks with a height of 1. Where peaks overlap, the maximum counts.

    shape: the shape of the result, (N, classes, H, W).
    channel: the index in N (K) and the class (K) of each peak.
    row: (K) the row of each peak's cell.
    column: (K) the column of each peak's cell.
    spread: (K) the standard deviations [cells]; smaller values are raised to MIN_SPREAD_CELLS.

    Returns the heatmaps (N, classes, H, W).
    """
    spread = spread.clamp(min=MIN_SPREAD_CELLS)
    num_classes, height, width = shape[1:]
    rows = torch.arange(height, device=row.device) - row[:, None]
    columns = torch.arange(width, device=row.device) - column[:, None]
    squares = rows[:, :, None] ** 2 + columns[:, None, :] ** 2
    peaks = torch.exp(-squares / (2 * spread[:, None, None] ** 2))
    heatmaps = torch.zeros(shape, device=row.device).view(-1, height * width)
    index = channel[0] * num_classes + channel[1]
    heatmaps.scatter_reduce_(0, index[:, None].expand(-1, height * width), peaks.flatten(1), "amax")
    return heatmaps.view(shape)


def neighbouring_cells(row: Tensor, column: Tensor, height: int, width: int) -> tuple[Tensor, Tensor]:
    """The 3×3 cells around each of K cells, without the cells outside a grid of height × width.

    row: (K) the rows of the cells.
    column: (K) the columns of the cells.

    Returns the numbers row * width + column of the neighbouring cells, and for each one the index in K of its centre.
    """
    step = torch.arange(-1, 2, device=row.device)
    rows, columns = row[:, None, None] + step[:, None], column[:, None, None] + step
    on_grid = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
    index = torch.arange(len(row), device=row.device)[:, None, None].expand_as(on_grid)
    return (rows * width + columns)[on_grid], index[on_grid]


def is_group_minimum(cost: Tensor, group: Tensor) -> Tensor:
    """Whether each element has the least cost in its group.

    cost: (K).
    group: (K) the number of each element's group, from 0.

    Returns (K) bool. If several elements of a group have the least cost, all of them are True.
    """
    least = cost.new_full((int(group.max()) + 1 if len(group) else 0,), torch.inf)
    return cost == least.scatter_reduce(0, group, cost, "amin")[group]


def heatmap_loss(logits: Tensor, targets: Tensor) -> Tensor:
    """CornerNet's focal loss (Law and Deng, 2018, eq. 1), divided by the number of peaks.

    logits: (N, classes, H, W).
    targets: of the same shape; 1 at peaks, less around them, where a high score is penalised less.
    """
    # log p and log (1 - p), which do not overflow for large logits.
    log_score, log_rest = F.logsigmoid(logits), F.logsigmoid(-logits)
    score = log_score.exp()
    is_peak = targets == 1
    at_peaks = torch.where(is_peak, (1 - score) ** 2 * log_score, 0.0)
    elsewhere = torch.where(is_peak, 0.0, (1 - targets) ** 4 * score**2 * log_rest)
    return -(at_peaks + elsewhere).sum() / is_peak.sum().clamp(min=1)
