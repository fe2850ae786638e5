"""Training frames: a frame's inputs and its ground truth as tensors."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from ...data.box_selection import BoxSelection, select_boxes
from ...data.mask_resampling import resample_mask
from ...model import DuoSpaceNetConfig
from ...runtime.bundle.preprocessing_record import Preprocessing
from ...runtime.errors import InputError
from ...runtime.frame import Frame, GroundTruth
from ...runtime.geometry import nearest_rigid
from ...runtime.preprocessing import prepare
from ...runtime.validation import check_frame
from ..tasks import BOTH_TASKS, Tasks


class TrainingFrame(NamedTuple):
    """The inputs and the ground truth of one frame.

    images: (N, H, W, 3) uint8, BGR.
    image_T_ego: (N, 3, 4) [px], from the ego frame to pixels of the images.
    camera_valid: (N) bool; False for a camera that has no image.
    global_T_ego: (4, 4) float64 [m], from the ego frame to the global frame.
    timestamp_s: () float64 [s].
    boxes: (D, 9) x y z w l h [m], yaw [rad], vx vy [m/s] in the ego frame; an unknown velocity is NaN.
    labels: (D) int64 indices into the classes of the model.
    boxes_known: () bool; False if the boxes are unknown, or not trained. The list of boxes is then empty.
    maps: (map classes, X, Y) bool on the grid of the model; masks of another grid are resampled.
    map_known: (map classes) bool; False for a map class without a ground-truth mask, or if maps are not trained.
    """

    images: Tensor
    image_T_ego: Tensor
    camera_valid: Tensor
    global_T_ego: Tensor
    timestamp_s: Tensor
    boxes: Tensor
    labels: Tensor
    boxes_known: Tensor
    maps: Tensor
    map_known: Tensor

    def to(self, device: torch.device) -> "TrainingFrame":
        """This frame on a device. The pose and the time are not moved: the device gets only their differences.

        `boxes_known` is not moved either, so that it can be read without waiting for the device.
        """
        moved = TrainingFrame(*(tensor.to(device, non_blocking=True) for tensor in self))
        kept = {name: getattr(self, name) for name in ("global_T_ego", "timestamp_s", "boxes_known")}
        return moved._replace(**kept)


Clip = list[TrainingFrame]  # frames of one scene, the oldest first

UNKNOWN = GroundTruth(np.zeros((0, 9)), (), has_boxes=False)


def make_training_frame(
    frame: Frame, config: DuoSpaceNetConfig, preprocessing: Preprocessing, tasks: Tasks = BOTH_TASKS
) -> TrainingFrame:
    """Prepare a frame for training. Boxes are left out as in `select_training_boxes`.

    frame: a frame, whose ground truth may be unknown.
    config: the configuration of the model that is trained.
    preprocessing: the preprocessing of camera images for this model.
    tasks: the tasks that are trained. The ground truth of the others is not looked at.

    Raises InputError, with the frame's token, if the runtime would refuse the frame, or if class names are unknown.
    """
    try:
        check_frame(frame, config.num_cameras)
    except InputError as error:
        raise InputError(f"frame {frame.token}: {error}") from None
    inputs = prepare(frame, preprocessing, config.num_cameras)
    ground_truth = trained_ground_truth(frame.ground_truth, tasks)
    selection = select_training_boxes(ground_truth, config, f"frame {frame.token}: ground truth")
    labels = np.array([config.classes.index(name) for name in selection.classes], np.int64)
    return TrainingFrame(
        torch.from_numpy(inputs.images),
        torch.from_numpy(inputs.image_T_ego),
        torch.from_numpy(inputs.camera_valid),
        torch.from_numpy(nearest_rigid(frame.global_T_ego)),  # as the runtime's history does
        torch.tensor(frame.timestamp_s, dtype=torch.float64),
        torch.from_numpy(selection.boxes.astype(np.float32)),
        torch.from_numpy(labels),
        torch.tensor(ground_truth.has_boxes),
        torch.from_numpy(_maps(ground_truth, config)),
        torch.tensor([name in ground_truth.maps for name in config.map_classes], dtype=torch.bool),
    )


def trained_ground_truth(ground_truth: GroundTruth | None, tasks: Tasks) -> GroundTruth:
    """The ground truth of the tasks that are trained. That of the other tasks is replaced by "unknown"."""
    known = UNKNOWN if ground_truth is None else ground_truth
    if not tasks.detection:
        known = replace(UNKNOWN, maps=known.maps)
    return known if tasks.maps else replace(known, maps={})


def missing_boxes_error(token: str) -> InputError:
    """The error for a frame with unknown ground-truth boxes."""
    return InputError(f"frame {token}: expected ground-truth boxes; got none. Train on a source with ground truth.")


def select_training_boxes(ground_truth: GroundTruth, config: DuoSpaceNetConfig, place: str) -> BoxSelection:
    """Select the boxes that a model is trained on: of its classes, in its voxel grid, and with lidar or radar points.

    place: where the boxes are, for the error.

    Raises InputError for class names that are not known.
    """
    selection = select_boxes(ground_truth, config.classes, place)
    lower, upper = np.array(config.voxels.lower_m[:2]), np.array(config.voxels.upper_m[:2])
    centres = selection.boxes[:, :2]
    in_grid = np.logical_and.reduce((centres >= lower) & (centres <= upper), axis=1)
    return selection.keep(in_grid, "range").keep_observed()


def _maps(ground_truth: GroundTruth, config: DuoSpaceNetConfig) -> np.ndarray:
    """The ground-truth maps (map classes, X, Y) bool; all False for a map class without a mask."""
    grid = config.voxels.size[:2]
    unknown = np.zeros(grid, bool)
    masks = [resample_mask(ground_truth.maps.get(name, unknown), grid) for name in config.map_classes]
    return np.array(masks, bool).reshape(-1, *grid)
