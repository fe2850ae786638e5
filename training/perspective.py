"""Perspective supervision: what stands in for the perspective-view pre-training of the paper's backbones.

The paper starts from weights that FCOS3D learned. Without such weights a backbone learns slowly from a few hundred
queries alone, so that while training a small head finds the objects in each picture as well (BEVFormer v2 does the
same, Yang et al., 2023). It is no part of the model.
"""

from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ..model import DuoSpaceNetConfig
from ..model.geometry import project
from .initialisation import PRIOR
from .losses import Losses

HEATMAP_WEIGHT = 1.0
DEPTH_WEIGHT = 0.5
SPREAD = 0.25  # of an object's apparent height; the standard deviation of its peak
LEAST_SPREAD_CELLS = 0.7


class Peaks(NamedTuple):
    """Where objects are seen: camera (K), row and column (K) of the cell, box (K) their index, depth_m (K)."""

    camera: Tensor
    row: Tensor
    column: Tensor
    box: Tensor
    depth_m: Tensor


class PerspectiveHead(nn.Module):
    """On the finest PV level: a heatmap a class, with peaks at the projected centres (Zhou et al., 2019), and the
    logarithm of the depth.
    """

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        self.config = config
        hidden = nn.Conv2d(config.channels, config.channels, 3, padding=1)
        last = nn.Conv2d(config.channels, len(config.classes) + 1, 1)
        self.layers = nn.Sequential(hidden, nn.ReLU(inplace=True), last)
        assert last.bias is not None
        nn.init.constant_(last.bias[:-1], torch.tensor(PRIOR / (1 - PRIOR)).log().item())

    def forward(self, pv: Tensor) -> tuple[Tensor, Tensor]:
        """pv (N, C, H, W), the finest level; returns logits (N, classes, H, W) and log depths (N, H, W)."""
        maps = self.layers(pv)
        return maps[:, :-1], maps[:, -1]

    def losses(self, pv: Tensor, image_T_ego: Tensor, camera_valid: Tensor, boxes: Tensor, labels: Tensor) -> Losses:
        """`heatmap` and `depth`, of one frame; boxes (D, 9), labels (D)."""
        logits, log_depth = self(pv)
        logits, log_depth = logits.float(), log_depth.float()
        peaks = find_peaks(self.config, boxes, image_T_ego, camera_valid, (pv.shape[2], pv.shape[3]))
        targets = draw_heatmaps(self.config, logits.shape, peaks, boxes, labels, image_T_ego)
        expected = peaks.depth_m.log()
        depth = (log_depth[peaks.camera, peaks.row, peaks.column] - expected).abs().sum() / max(1, len(expected))
        return {"heatmap": HEATMAP_WEIGHT * heatmap_loss(logits, targets), "depth": DEPTH_WEIGHT * depth}


def heatmap_loss(logits: Tensor, targets: Tensor) -> Tensor:
    """CornerNet's focal loss (Law and Deng, 2018, eq. 1), a peak: peaks are 1, round them it matters less."""
    log_score, log_rest = F.logsigmoid(logits), F.logsigmoid(-logits)
    score = log_score.exp()
    is_peak = targets == 1
    at_peaks = torch.where(is_peak, (1 - score) ** 2 * log_score, 0.0)
    elsewhere = torch.where(is_peak, 0.0, (1 - targets) ** 4 * score**2 * log_rest)
    return -(at_peaks + elsewhere).sum() / is_peak.sum().clamp(min=1)


def find_peaks(
    config: DuoSpaceNetConfig, boxes: Tensor, image_T_ego: Tensor, camera_valid: Tensor, size: tuple[int, int]
) -> Peaks:
    """The cells, of H×W, in which the centres of boxes (D, 9) lie, in each camera that is there."""
    locations, seen = project(boxes[:, :3], image_T_ego, config.image.width_px, config.image.height_px)
    camera, box = torch.nonzero(seen & camera_valid[:, None], as_tuple=True)
    at = locations[camera, box]
    row, column = (at[:, 1] * size[0]).long(), (at[:, 0] * size[1]).long()
    axis = image_T_ego[camera, 2]
    depth_m = (axis[:, :3] * boxes[box, :3]).sum(dim=1) + axis[:, 3]
    return Peaks(camera, row.clamp(max=size[0] - 1), column.clamp(max=size[1] - 1), box, depth_m)


def draw_heatmaps(
    config: DuoSpaceNetConfig, shape: torch.Size, peaks: Peaks, boxes: Tensor, labels: Tensor, image_T_ego: Tensor
) -> Tensor:
    """(N, classes, H, W): a Gaussian at every peak, 1 in its cell, as wide as the object appears."""
    _, _, height, width = shape
    targets = torch.zeros(shape, device=boxes.device)
    apparent_px = boxes[peaks.box, 5] * focal_lengths(image_T_ego)[peaks.camera] / peaks.depth_m
    apparent = apparent_px * height / config.image.height_px
    spread = (SPREAD * apparent).clamp(min=LEAST_SPREAD_CELLS)
    rows = torch.arange(height, device=boxes.device) - peaks.row[:, None]
    columns = torch.arange(width, device=boxes.device) - peaks.column[:, None]
    squares = rows[:, :, None] ** 2 + columns[:, None, :] ** 2
    drawn = torch.exp(-squares / (2 * spread[:, None, None] ** 2))
    place = peaks.camera * shape[1] + labels[peaks.box]
    flat = targets.view(-1, height * width)
    flat.scatter_reduce_(0, place[:, None].expand(-1, height * width), drawn.flatten(1), "amax")
    return targets


def focal_lengths(image_T_ego: Tensor) -> Tensor:
    """(N) [px], from image to image: what of the second row of K R stands upright on the third, the optical axis."""
    rows = image_T_ego[:, :, :3]
    along = (rows[:, 1] * rows[:, 2]).sum(dim=1, keepdim=True)
    return (rows[:, 1] - along * rows[:, 2]).norm(dim=1)
