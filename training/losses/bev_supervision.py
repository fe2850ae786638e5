"""BEV supervision: a detection head on the BEV features that is used in training only.

Queries sample the BEV features at few positions, so only the features there get a gradient. This head gives every cell
a gradient. It is the first stage of CenterPoint (Yin et al., 2021). It is not part of the model.
"""

import torch
from torch import Tensor, nn

from ...model import DuoSpaceNetConfig
from ...model.duospacenet import FrameFeatures
from ...model.pose_vectors import encode_boxes
from ...model.projection import axis_centres
from ...model.sampling import bev_locations
from ..samples.training_frames import TrainingFrame
from .frame_losses import BOX_WEIGHT, Losses, box_loss
from .heatmaps import draw_heatmaps, heatmap_head, heatmap_loss, is_group_minimum, neighbouring_cells
from .hungarian_matching import Assignment

HEATMAP_WEIGHT = 1.0
SPREAD = 0.25  # standard deviation of an object's peak, relative to its shorter side


class BEVSupervisionHead(nn.Module):
    """Predicts a heatmap of object centres per class, and a pose vector in every cell.

    The x and y of a pose vector are relative to the centre of its cell. The pose vectors of an object's cell and of the
    eight cells around it are trained. A cell with several objects is trained on the nearest.

    loss_names: the names of the losses.
    """

    loss_names = ("heatmap_bev", "box_bev")
    centres: Tensor

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        self.voxels = config.voxels
        self.layers = heatmap_head(config.channels, len(config.classes), 10)
        x, y, _ = axis_centres(config.voxels)
        self.register_buffer("centres", torch.stack(torch.meshgrid(x, y, indexing="ij")).float(), persistent=False)

    def forward(self, features: FrameFeatures) -> Tensor:
        """Convert F_BEV (1, C, X, Y) to class logits and pose vectors, (1, classes + 10, X, Y)."""
        assert features.bev is not None
        return self.layers(features.bev)

    def losses(self, maps: Tensor, frame: TrainingFrame) -> Losses:
        """The losses of one frame, `heatmap_bev` and `box_bev`.

        maps: (1, classes + 10, X, Y), the result of `forward`.
        """
        logits, poses = maps[:, :-10], maps[0, -10:]
        poses = torch.cat((poses[:2] + self.centres, poses[2:])).flatten(1).mT
        row, column = self.cells(frame.boxes)
        cell_m = (self.voxels.upper_m[0] - self.voxels.lower_m[0]) / self.voxels.size[0]
        spread = SPREAD * frame.boxes[:, 3:5].amin(dim=1) / cell_m
        channel = (torch.zeros_like(frame.labels), frame.labels)
        targets = draw_heatmaps(logits.shape, channel, row, column, spread)
        box = box_loss(poses, encode_boxes(frame.boxes), self.assign_cells_to_boxes(frame.boxes, row, column))
        return {"heatmap_bev": HEATMAP_WEIGHT * heatmap_loss(logits, targets), "box_bev": BOX_WEIGHT * box}

    def cells(self, boxes: Tensor) -> tuple[Tensor, Tensor]:
        """The row (D) and the column (D) of the cells that contain the centres of boxes (D, 9)."""
        count = boxes.new_tensor(self.voxels.size[:2])
        index = (bev_locations(boxes[:, :2], self.voxels).flip(-1) * count).floor()
        return tuple(torch.minimum(index.clamp(min=0), count - 1).long().unbind(dim=1))  # type: ignore[return-value]

    def assign_cells_to_boxes(self, boxes: Tensor, row: Tensor, column: Tensor) -> Assignment:
        """Assign each box to its 3×3 cells. A cell near several boxes is assigned to the one with the nearest centre.

        boxes: (D, 9), with their centres in the cells `row` (D) and `column` (D).

        Returns an assignment in which the cells, numbered row * Y + column, are the queries.
        """
        cell, box = neighbouring_cells(row, column, *self.voxels.size[:2])
        distance_m = (self.centres.flatten(1).mT[cell] - boxes[box, :2]).norm(dim=1)
        kept = is_group_minimum(distance_m, cell)
        return Assignment(cell[kept], box[kept])
