"""Perspective supervision: what stands in for the perspective-view pre-training of the paper's backbones.

The paper starts from weights that FCOS3D learned. Without such weights a backbone learns slowly from a few hundred
queries alone, so that while training a small head finds the objects in each picture as well (BEVFormer v2 does the
same, Yang et al., 2023). It is no part of the model.
"""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from ..model import DuoSpaceNetConfig
from ..model.duospacenet import FrameFeatures
from ..model.geometry import project
from .heatmaps import draw_heatmaps, heatmap_head, heatmap_loss
from .losses import Losses
from .samples import Sample

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
    logarithm of how deep, in focal lengths: what appears as large in two cameras has the same.
    """

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        self.config = config
        self.layers = heatmap_head(config.channels, len(config.classes), 1)

    def forward(self, pv: Tensor) -> tuple[Tensor, Tensor]:
        """pv (N, C, H, W), the finest level; returns logits (N, classes, H, W) and log depths (N, H, W)."""
        maps = self.layers(pv)
        return maps[:, :-1], maps[:, -1]

    def losses(self, features: FrameFeatures, sample: Sample) -> Losses:
        """`heatmap_pv` and `depth_pv`, of one frame."""
        logits, log_depth = self(features.pv[0])
        peaks = find_peaks(self.config, sample.boxes, sample.image_T_ego, sample.camera_valid, logits.shape[2:])
        focal_px = focal_lengths(sample.image_T_ego)[peaks.camera]
        apparent_px = sample.boxes[peaks.box, 5] * focal_px / peaks.depth_m
        spread = (SPREAD * apparent_px * logits.shape[2] / self.config.image.height_px).clamp(min=LEAST_SPREAD_CELLS)
        place = (peaks.camera, sample.labels[peaks.box])
        targets = draw_heatmaps(logits.shape, place, peaks.row, peaks.column, spread)
        expected = (peaks.depth_m * self.config.image.height_px / focal_px).log()
        depth = (log_depth[peaks.camera, peaks.row, peaks.column] - expected).abs().sum() / max(1, len(expected))
        return {"heatmap_pv": HEATMAP_WEIGHT * heatmap_loss(logits, targets), "depth_pv": DEPTH_WEIGHT * depth}


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


def focal_lengths(image_T_ego: Tensor) -> Tensor:
    """(N) [px], from image to image: what of the second row of K R stands upright on the third, the optical axis."""
    rows = image_T_ego[:, :, :3]
    along = (rows[:, 1] * rows[:, 2]).sum(dim=1, keepdim=True)
    return (rows[:, 1] - along * rows[:, 2]).norm(dim=1)
