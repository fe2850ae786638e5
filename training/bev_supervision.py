"""Bird's-eye supervision: a small head that finds the objects in the BEV features while they are learned.

Queries look at few places each, and teach the features of a frame there alone; this head teaches them everywhere
(CenterPoint's first stage, Yin et al., 2021). It is no part of the model.
"""

import torch
from torch import Tensor, nn

from ..model import DuoSpaceNetConfig
from ..model.duospacenet import FrameFeatures
from ..model.pose_vectors import encode_boxes
from ..model.projection import axis_centres
from ..model.sampling import bev_coordinates
from .heatmaps import cells_around, draw_heatmaps, heatmap_head, heatmap_loss, least_of_each
from .hungarian_matching import Assignment
from .losses import BOX_WEIGHT, Losses, box_loss
from .training_frames import TrainingFrame

HEATMAP_WEIGHT = 1.0
SPREAD = 0.25  # of the lesser side of an object; the standard deviation of its peak


class BEVSupervisionHead(nn.Module):
    """On F_BEV: a heatmap a class, with peaks at the centres; and in each cell a pose vector (10), x and y from the
    cell's centre on, which an object's cell and the eight around it learn, each of the object nearest to it.
    """

    centres: Tensor

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        self.voxels = config.voxels
        self.layers = heatmap_head(config.channels, len(config.classes), 10)
        x, y, _ = axis_centres(config.voxels)
        self.register_buffer("centres", torch.stack(torch.meshgrid(x, y, indexing="ij")).float(), persistent=False)

    def forward(self, features: FrameFeatures) -> Tensor:
        """Of F_BEV (1, C, X, Y): (1, classes + 10, X, Y), logits and pose vectors."""
        assert features.bev is not None
        return self.layers(features.bev)

    def losses(self, maps: Tensor, sample: TrainingFrame) -> Losses:
        """`heatmap_bev` and `box_bev`, of one frame; maps: what `forward` gave."""
        logits, poses = maps[:, :-10], maps[0, -10:]
        poses = torch.cat((poses[:2] + self.centres, poses[2:])).flatten(1).mT
        row, column = self.cells(sample.boxes)
        cell_m = (self.voxels.upper_m[0] - self.voxels.lower_m[0]) / self.voxels.size[0]
        spread = SPREAD * sample.boxes[:, 3:5].amin(dim=1) / cell_m
        place = (torch.zeros_like(sample.labels), sample.labels)
        targets = draw_heatmaps(logits.shape, place, row, column, spread)
        box = box_loss(poses, encode_boxes(sample.boxes), self.learners(sample.boxes, row, column))
        return {"heatmap_bev": HEATMAP_WEIGHT * heatmap_loss(logits, targets), "box_bev": BOX_WEIGHT * box}

    def cells(self, boxes: Tensor) -> tuple[Tensor, Tensor]:
        """Row and column (D) of the cells in which the centres of boxes (D, 9) lie."""
        count = boxes.new_tensor(self.voxels.size[:2])
        place = ((bev_coordinates(boxes[:, :2], self.voxels).flip(-1) + 1) / 2 * count).floor()
        return tuple(torch.minimum(place.clamp(min=0), count - 1).long().unbind(dim=1))  # type: ignore[return-value]

    def learners(self, boxes: Tensor, row: Tensor, column: Tensor) -> Assignment:
        """Which cell, by number, learns which of the boxes (D, 9), which lie in cells row, column (D): the nearest."""
        cell, box = cells_around(row, column, *self.voxels.size[:2])
        away_m = (self.centres.flatten(1).mT[cell] - boxes[box, :2]).norm(dim=1)
        kept = least_of_each(away_m, cell)
        return Assignment(cell[kept], box[kept])
