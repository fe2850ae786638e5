"""Frames with their truth, as tensors to train on."""

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from ..model import DuoSpaceNetConfig
from ..runtime.bundle.manifest import Preprocessing
from ..runtime.errors import InputError
from ..runtime.frame import Frame, GroundTruth
from ..runtime.geometry import nearest_rigid
from ..runtime.preprocessing import prepare_inputs
from ..runtime.validation import check_frame


class TrainingFrame(NamedTuple):
    """One frame of a drive.

    images (N, H, W, 3) uint8 BGR; image_T_ego (N, 3, 4) [px]; camera_valid (N) bool; global_T_ego (4, 4) float64;
    timestamp_s () float64. boxes (D, 9): x y z w l h yaw vx vy in the ego frame; labels (D): indices into the classes;
    maps (classes of the map, X, Y) bool.
    """

    images: Tensor
    image_T_ego: Tensor
    camera_valid: Tensor
    global_T_ego: Tensor
    timestamp_s: Tensor
    boxes: Tensor
    labels: Tensor
    maps: Tensor

    def to(self, device: torch.device) -> "Sample":
        """The same on a device; poses and times stay where they are, for only their differences go there."""
        pose, time = self.global_T_ego, self.timestamp_s
        moved = TrainingFrame(*(tensor.to(device, non_blocking=True) for tensor in self))
        return moved._replace(global_T_ego=pose, timestamp_s=time)


def make_training_frame(frame: Frame, config: DuoSpaceNetConfig, preprocessing: Preprocessing) -> TrainingFrame:
    """A frame as `config` sees it. Boxes of other classes, and those beyond its voxels, are left out.

    Raises InputError, naming the frame, where it is none that the runtime takes, or is without truth, or without a map
    that is to be learned, or has one of another grid.
    """
    truth = ground_truth_of(frame)
    try:
        check_frame(frame, config.num_cameras)
    except InputError as error:
        raise InputError(f"frame {frame.token}: {error}") from None
    inputs = prepare_inputs(frame, preprocessing, config.num_cameras)
    boxes, labels = _known(truth, config)
    return TrainingFrame(
        torch.from_numpy(inputs.images),
        torch.from_numpy(inputs.image_T_ego),
        torch.from_numpy(inputs.camera_valid),
        torch.from_numpy(nearest_rigid(frame.global_T_ego)),
        torch.tensor(frame.timestamp_s, dtype=torch.float64),
        torch.from_numpy(boxes),
        torch.from_numpy(labels),
        torch.from_numpy(_maps(frame.token, truth, config)),
    )


def ground_truth_of(frame: Frame) -> GroundTruth:
    """The truth of a frame. Raises InputError, naming the frame, where it has no boxes."""
    if frame.ground_truth is None or not frame.ground_truth.has_boxes:
        raise missing_boxes_error(frame.token)
    return frame.ground_truth


def missing_boxes_error(token: str) -> InputError:
    return InputError(f"frame {token}: expected true boxes; got none. Train on a source with truth.")


def _known(truth: GroundTruth, config: DuoSpaceNetConfig) -> tuple[np.ndarray, np.ndarray]:
    """Boxes (D, 9) float32 and labels (D) int64. A velocity that is not known (NaN) stays so."""
    labels = np.array([_index(name, config.classes) for name in truth.classes], dtype=np.int64)
    lower, upper = np.array(config.voxels.lower_m[:2]), np.array(config.voxels.upper_m[:2])
    centres = truth.boxes[:, :2]
    kept = (labels >= 0) & (centres >= lower).all(axis=1) & (centres <= upper).all(axis=1)
    return truth.boxes[kept].astype(np.float32), labels[kept]


def _maps(token: str, truth: GroundTruth, config: DuoSpaceNetConfig) -> np.ndarray:
    """(classes of the map, X, Y) bool."""
    grid = config.voxels.size[:2]
    for name in config.map_classes:
        mask = truth.maps.get(name)
        if mask is None or mask.shape != grid:
            got = "none" if mask is None else f"one of {mask.shape[0]}x{mask.shape[1]}"
            raise InputError(
                f"frame {token}: expected a true map {name!r} of {grid[0]}x{grid[1]} cells; got {got}. Train on a "
                "source with such maps."
            )
    return np.array([truth.maps[name] for name in config.map_classes], bool).reshape(-1, *grid)


def _index(name: str, names: tuple[str, ...]) -> int:
    return names.index(name) if name in names else -1
