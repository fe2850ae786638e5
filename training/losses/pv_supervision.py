"""PV supervision: a monocular 3D detection head on the PV features that is used in training only.

The paper starts from a backbone that was pretrained with FCOS3D (Wang et al., 2021). Here a small head learns the
targets of FCOS3D on the finest PV level. It is used in two ways: with the image encoder alone in pretraining, and
together with the whole model, as in BEVFormer v2 (Yang et al., 2023). It is not part of the model.
"""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from ...model import DuoSpaceNetConfig
from ...model.duospacenet import FrameFeatures
from ...model.projection import project
from ..samples.training_frames import TrainingFrame
from .frame_losses import Losses
from .heatmaps import draw_heatmaps, heatmap_head, heatmap_loss, is_group_minimum, neighbouring_cells

HEATMAP_WEIGHT = 1.0
DEPTH_WEIGHT = 2.0
APPEARANCE_WEIGHTS = (0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5)
SPREAD = 0.25  # standard deviation of an object's peak, relative to its apparent height


class Peaks(NamedTuple):
    """The projected centres of objects, one per camera and visible object.

    camera: (K) index of the camera.
    row: (K) row of the cell that contains the centre.
    column: (K) column of this cell.
    position: (K, 2) position of the centre [cells], from the left and from the top of the image.
    box: (K) index of the object.
    depth_m: (K) depth of the centre along the optical axis.
    """

    camera: Tensor
    row: Tensor
    column: Tensor
    position: Tensor
    box: Tensor
    depth_m: Tensor


class PVSupervisionHead(nn.Module):
    """Predicts a heatmap of projected object centres per class (Zhou et al., 2019), and values in every cell.

    The values are a depth and an appearance.

    The depth is the logarithm of the depth [m] divided by the focal length in image heights. Objects of the same
    apparent size therefore have the same value in different cameras. The appearance has 7 values: the position of the
    centre relative to the cell, the logarithms of the size, and the sine and cosine of the yaw relative to the line of
    sight. Depth and appearance are trained in the 3×3 cells around each centre.

    loss_names: the names of the losses.
    """

    loss_names = ("heatmap_pv", "depth_pv", "appearance_pv")

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        self.config = config
        self.layers = heatmap_head(config.channels, len(config.classes), 1 + len(APPEARANCE_WEIGHTS))

    def forward(self, features: FrameFeatures) -> Tensor:
        """Convert the finest PV level (N, C, H, W) to class logits, depth and appearance, (N, classes + 8, H, W)."""
        return self.layers(features.pv[0])

    def losses(self, maps: Tensor, frame: TrainingFrame) -> Losses:
        """The losses of one frame, `heatmap_pv`, `depth_pv` and `appearance_pv`.

        maps: (N, classes + 8, H, W), the result of `forward`.
        """
        num_classes, (height, width) = len(self.config.classes), maps.shape[2:]
        logits, values = maps[:, :num_classes], maps[:, num_classes:].permute(0, 2, 3, 1).flatten(1, 2)
        peaks = find_peaks(self.config, frame.boxes, frame.image_T_ego, frame.camera_valid, (height, width))
        focal = focal_lengths(frame.image_T_ego)[peaks.camera] / self.config.image.height_px
        apparent_height = frame.boxes[peaks.box, 5] * focal / peaks.depth_m
        spread = SPREAD * apparent_height * height
        channel = (peaks.camera, frame.labels[peaks.box])
        targets = draw_heatmaps(logits.shape, channel, peaks.row, peaks.column, spread)
        cell, peak = assign_cells_to_peaks(peaks, height, width)
        predicted = values[peaks.camera[peak], cell]
        depth = (predicted[:, 0] - (peaks.depth_m / focal).log()[peak]).abs()
        centre = torch.stack((cell % width, cell // width), dim=1) + 0.5
        expected = torch.cat((peaks.position[peak] - centre, size_and_yaw(peaks, frame)[peak]), dim=1)
        weights = predicted.new_tensor(APPEARANCE_WEIGHTS)
        appearance = ((predicted[:, 1:] - expected).abs() * weights).sum(dim=1)
        count = max(1, len(cell))
        return {
            "heatmap_pv": HEATMAP_WEIGHT * heatmap_loss(logits, targets),
            "depth_pv": DEPTH_WEIGHT * depth.sum() / count,
            "appearance_pv": appearance.sum() / count,
        }


def find_peaks(
    config: DuoSpaceNetConfig, boxes: Tensor, image_T_ego: Tensor, camera_valid: Tensor, size: tuple[int, int]
) -> Peaks:
    """Project the centres of boxes into every camera that has an image.

    config: the model's configuration, which gives the image size.
    boxes: (D, 9), in the ego frame.
    image_T_ego: (N, 3, 4) [px], from the ego frame to pixels of the images.
    camera_valid: (N) bool; False for a lost camera.
    size: the numbers of rows and columns of cells per image.
    """
    locations, visible = project(boxes[:, :3], image_T_ego, config.image.width_px, config.image.height_px)
    camera, box = torch.nonzero(visible & camera_valid[:, None], as_tuple=True)
    position = locations[camera, :, box] * locations.new_tensor([size[1], size[0]])
    row, column = position[:, 1].long().clamp(max=size[0] - 1), position[:, 0].long().clamp(max=size[1] - 1)
    # The third row of image_T_ego is the optical axis: its product with a point is the depth of the point.
    axis = image_T_ego[camera, 2]
    depth_m = (axis[:, :3] * boxes[box, :3]).sum(dim=1) + axis[:, 3]
    return Peaks(camera, row, column, position, box, depth_m)


def assign_cells_to_peaks(peaks: Peaks, height: int, width: int) -> tuple[Tensor, Tensor]:
    """Assign the 3×3 cells around each peak to the peak. A cell near several peaks is assigned to the nearest object.

    Returns the cell numbers row * width + column within their camera, and the index of each cell's peak.
    """
    cell, peak = neighbouring_cells(peaks.row, peaks.column, height, width)
    kept = is_group_minimum(peaks.depth_m[peak], peaks.camera[peak] * height * width + cell)
    return cell[kept], peak[kept]


def size_and_yaw(peaks: Peaks, frame: TrainingFrame) -> Tensor:
    """log w, log l, log h, and the sine and cosine of the yaw relative to the line of sight, (K, 5)."""
    boxes, cameras = frame.boxes[peaks.box], frame.image_T_ego[peaks.camera]
    # The centre c of a camera solves image_T_ego [c, 1] = 0.
    camera_centres = -torch.linalg.solve(cameras[:, :, :3], cameras[:, :, 3])
    sight = boxes[:, :2] - camera_centres[:, :2]
    yaw = boxes[:, 6] - torch.atan2(sight[:, 1], sight[:, 0])
    # In a flipped image, whose projection has a negative determinant, objects appear turned the other way.
    yaw = yaw * torch.linalg.det(cameras[:, :, :3]).sign()
    return torch.cat((boxes[:, 3:6].log(), torch.stack((yaw.sin(), yaw.cos()), dim=1)), dim=1)


def focal_lengths(image_T_ego: Tensor) -> Tensor:
    """The vertical focal lengths (N) [px] of cameras with image_T_ego (N, 3, 4).

    The rows of K R are (f_x, s, c_x), (0, f_y, c_y) and (0, 0, 1) times an orthonormal R. So f_y is the length of the
    second row without its component along the third row, the optical axis.
    """
    rows = image_T_ego[:, :, :3]
    along_axis = (rows[:, 1] * rows[:, 2]).sum(dim=1, keepdim=True)
    return (rows[:, 1] - along_axis * rows[:, 2]).norm(dim=1)
