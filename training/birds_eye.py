"""Bird's-eye supervision: a small head that finds the objects in the BEV features while they are learned.

Queries look at few places each, and teach the features of a frame there alone; this head teaches them everywhere
(CenterPoint's first stage, Yin et al., 2021). It is no part of the model.
"""

import torch
from torch import Tensor, nn

from ..model import DuoSpaceNetConfig
from ..model.duospacenet import FrameFeatures
from ..model.geometry import axis_centres, encode_boxes
from .heatmaps import draw_heatmaps, heatmap_head, heatmap_loss
from .losses import BOX_WEIGHT, Losses, box_loss
from .matching import Match
from .samples import Sample

HEATMAP_WEIGHT = 1.0
SPREAD = 0.25  # of the lesser side of an object; the standard deviation of its peak
LEAST_SPREAD_CELLS = 0.7


class BirdsEyeHead(nn.Module):
    """On F_BEV: a heatmap a class, with peaks at the centres; and in each cell a pose vector (10), x and y from the
    cell's centre on, which an object's cell and the eight around it learn.
    """

    centres: Tensor

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        self.voxels = config.voxels
        self.layers = heatmap_head(config.channels, len(config.classes), 10)
        x, y, _ = axis_centres(config.voxels)
        self.register_buffer("centres", torch.stack(torch.meshgrid(x, y, indexing="ij")).float(), persistent=False)

    def forward(self, bev: Tensor) -> tuple[Tensor, Tensor]:
        """bev (1, C, X, Y); returns logits (1, classes, X, Y) and pose vectors (X, Y, 10)."""
        maps = self.layers(bev)
        poses = maps[0, -10:]
        return maps[:, :-10], torch.cat((poses[:2] + self.centres, poses[2:])).movedim(0, -1)

    def losses(self, features: FrameFeatures, sample: Sample) -> Losses:
        """`heatmap_bev` and `box_bev`, of one frame."""
        assert features.bev is not None
        logits, poses = self(features.bev)
        row, column = self.cells(sample.boxes)
        cell_m = (self.voxels.upper_m[0] - self.voxels.lower_m[0]) / self.voxels.size[0]
        spread = (SPREAD * sample.boxes[:, 3:5].amin(dim=1) / cell_m).clamp(min=LEAST_SPREAD_CELLS)
        place = (torch.zeros_like(sample.labels), sample.labels)
        targets = draw_heatmaps(logits.shape, place, row, column, spread)
        around = self.around(row, column)
        box = box_loss(poses.flatten(0, 1), encode_boxes(sample.boxes), around)
        return {"heatmap_bev": HEATMAP_WEIGHT * heatmap_loss(logits, targets), "box_bev": BOX_WEIGHT * box}

    def cells(self, boxes: Tensor) -> tuple[Tensor, Tensor]:
        """Row and column (D) of the cells in which the centres of boxes (D, 9) lie."""
        lower, upper = boxes.new_tensor(self.voxels.lower_m[:2]), boxes.new_tensor(self.voxels.upper_m[:2])
        count = boxes.new_tensor(self.voxels.size[:2])
        place = ((boxes[:, :2] - lower) / (upper - lower) * count).floor()
        return tuple(torch.minimum(place.clamp(min=0), count - 1).long().unbind(dim=1))  # type: ignore[return-value]

    def around(self, row: Tensor, column: Tensor) -> Match:
        """Which cell, counted along rows of the grid, learns which object: its own, and its neighbours on the grid."""
        count_x, count_y = self.voxels.size[:2]
        step = torch.arange(-1, 2, device=row.device)
        rows, columns = row[:, None, None] + step[:, None], column[:, None, None] + step
        on_grid = (rows >= 0) & (rows < count_x) & (columns >= 0) & (columns < count_y)
        objects = torch.arange(len(row), device=row.device)[:, None, None].expand_as(on_grid)
        return Match((rows * count_y + columns)[on_grid], objects[on_grid])
