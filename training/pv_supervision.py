"""Perspective supervision: what stands in for the perspective-view pre-training of the paper's backbones.

The paper starts from weights that FCOS3D learned (Wang et al., 2021). Here a small head learns FCOS3D's boxes on the
finest PV level: one with the image encoder alone, and a new one beside the whole model (as in BEVFormer v2, Yang et
al., 2023). It is no part of the model.
"""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from ..model import DuoSpaceNetConfig
from ..model.duospacenet import FrameFeatures
from ..model.projection import project
from .heatmaps import cells_around, draw_heatmaps, heatmap_head, heatmap_loss, least_of_each
from .losses import Losses
from .training_frames import TrainingFrame

HEATMAP_WEIGHT = 1.0
DEPTH_WEIGHT = 2.0
APPEARANCE_WEIGHTS = (0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5)
SPREAD = 0.25  # of an object's apparent height; the standard deviation of its peak


class Peaks(NamedTuple):
    """Where objects are seen: camera (K), row and column (K) of the cell, place (K, 2) in cells from the left and the
    top, box (K) their index, depth_m (K).
    """

    camera: Tensor
    row: Tensor
    column: Tensor
    place: Tensor
    box: Tensor
    depth_m: Tensor


class PVSupervisionHead(nn.Module):
    """A heatmap a class, with peaks at the projected centres (Zhou et al., 2019); and in the cells around each peak the
    logarithm of the depth [m] for a lens as long as the image is high, so that what appears as large in two cameras
    has the same, and how the object appears: where its centre is, its size, and its yaw as seen from the camera.
    """

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        self.config = config
        self.layers = heatmap_head(config.channels, len(config.classes), 1 + len(APPEARANCE_WEIGHTS))

    def forward(self, features: FrameFeatures) -> Tensor:
        """Of the finest PV level (N, C, H, W): (N, classes + 8, H, W), logits, the log depth and the appearance."""
        return self.layers(features.pv[0])

    def losses(self, maps: Tensor, sample: TrainingFrame) -> Losses:
        """`heatmap_pv`, `depth_pv` and `appearance_pv`, of one frame; maps: what `forward` gave."""
        num_classes, (height, width) = len(self.config.classes), maps.shape[2:]
        logits, values = maps[:, :num_classes], maps[:, num_classes:].permute(0, 2, 3, 1).flatten(1, 2)
        peaks = find_peaks(self.config, sample.boxes, sample.image_T_ego, sample.camera_valid, (height, width))
        focal = focal_lengths(sample.image_T_ego)[peaks.camera] / self.config.image.height_px
        apparent = sample.boxes[peaks.box, 5] * focal / peaks.depth_m
        spread = SPREAD * apparent * height
        targets = draw_heatmaps(logits.shape, (peaks.camera, sample.labels[peaks.box]), peaks.row, peaks.column, spread)
        cell, peak = nearest_around(peaks, height, width)
        found = values[peaks.camera[peak], cell]
        depth = (found[:, 0] - (peaks.depth_m / focal).log()[peak]).abs()
        centre = torch.stack((cell % width, cell // width), dim=1) + 0.5
        expected = torch.cat((peaks.place[peak] - centre, appearance(peaks, sample)[peak]), dim=1)
        look = ((found[:, 1:] - expected).abs() * found.new_tensor(APPEARANCE_WEIGHTS)).sum(dim=1)
        count = max(1, len(cell))
        return {
            "heatmap_pv": HEATMAP_WEIGHT * heatmap_loss(logits, targets),
            "depth_pv": DEPTH_WEIGHT * depth.sum() / count,
            "appearance_pv": look.sum() / count,
        }


def find_peaks(
    config: DuoSpaceNetConfig, boxes: Tensor, image_T_ego: Tensor, camera_valid: Tensor, size: tuple[int, int]
) -> Peaks:
    """The cells, of H×W, in which the centres of boxes (D, 9) lie, in each camera that is there."""
    locations, seen = project(boxes[:, :3], image_T_ego, config.image.width_px, config.image.height_px)
    camera, box = torch.nonzero(seen & camera_valid[:, None], as_tuple=True)
    place = locations[camera, box] * locations.new_tensor([size[1], size[0]])
    row, column = place[:, 1].long().clamp(max=size[0] - 1), place[:, 0].long().clamp(max=size[1] - 1)
    axis = image_T_ego[camera, 2]
    depth_m = (axis[:, :3] * boxes[box, :3]).sum(dim=1) + axis[:, 3]
    return Peaks(camera, row, column, place, box, depth_m)


def nearest_around(peaks: Peaks, height: int, width: int) -> tuple[Tensor, Tensor]:
    """The cells around the peaks, by number, and the peak that each is to tell of: of several, the nearest."""
    cell, peak = cells_around(peaks.row, peaks.column, height, width)
    kept = least_of_each(peaks.depth_m[peak], peaks.camera[peak] * height * width + cell)
    return cell[kept], peak[kept]


def appearance(peaks: Peaks, sample: TrainingFrame) -> Tensor:
    """(K, 5): log w l h, and sine and cosine of the yaw, from the line of sight on."""
    boxes, cameras = sample.boxes[peaks.box], sample.image_T_ego[peaks.camera]
    centres = -torch.linalg.solve(cameras[:, :, :3], cameras[:, :, 3])
    sight = boxes[:, :2] - centres[:, :2]
    yaw = boxes[:, 6] - torch.atan2(sight[:, 1], sight[:, 0])
    return torch.cat((boxes[:, 3:6].log(), torch.stack((yaw.sin(), yaw.cos()), dim=1)), dim=1)


def focal_lengths(image_T_ego: Tensor) -> Tensor:
    """(N) [px], from image to image: what of the second row of K R stands upright on the third, the optical axis."""
    rows = image_T_ego[:, :, :3]
    along = (rows[:, 1] * rows[:, 2]).sum(dim=1, keepdim=True)
    return (rows[:, 1] - along * rows[:, 2]).norm(dim=1)
