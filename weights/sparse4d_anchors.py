"""Sparse4D's anchors as pose vectors: from its `nuscenes_kmeans900.npy`, or from a checkpoint (Lin et al., 2022).

Sparse4D's anchors are (N, 11): x y z [m], the logarithms of three sizes [m], sin and cos of the yaw, vx vy vz [m/s].
They differ from our pose vectors in two ways (github.com/linxuewu/Sparse4D, commit 01981c5):

The sizes are along the box's own axes: length, width, height. Its code names them W, L, H, but it multiplies the first
one with the direction of the heading, and swaps the first two for nuScenes (`output_to_nusc_box`).

The frame is that of the sensor LIDAR_TOP: x to the right, y forward, z up.
"""

from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..runtime.geometry import rotation_from_quaternion
from .checkpoint_error import CheckpointError
from .checkpoint_file import read_file
from .flat_checkpoint import UnwrapError, flatten_checkpoint

# The calibrated_sensor of LIDAR_TOP in scene-0061 of nuScenes. The lidars of its other cars differ by a few centimetres
# and about a degree.
LIDAR_TRANSLATION_M = (0.943713, 0.0, 1.84023)
LIDAR_ROTATION = (0.7077955119163518, -0.006492242056004365, 0.010646214713995808, -0.7063073142877817)  # w x y z

NUM_COLUMNS = 11
_NAME = "instance_bank.anchor"  # the end of the tensor's name
_NUMPY_MAGIC = b"\x93NUMPY"
_MAX_FILE_BYTES = 10**8
_LARGEST_LOG_SIZE = 5.0  # 150 m


def read_sparse4d_anchors(path: Path, num_queries: int) -> Tensor:
    """Read Sparse4D's anchors as pose vectors (Q, 10) in the ego frame.

    path: a .npy file, or a checkpoint of Sparse4D.
    num_queries: the number of queries of the model, and of anchors in the file.

    Raises CheckpointError if the file cannot be read or has no such anchors, and OSError if it does not exist or there
    is no permission to read it.
    """
    anchors = _read_numpy(path) if _is_numpy(path) else _read_checkpoint(path)
    if anchors.shape != (num_queries, NUM_COLUMNS):
        raise CheckpointError(
            f"{path}: expected Sparse4D's anchors, one per query, shape {(num_queries, NUM_COLUMNS)}; got "
            f"{anchors.shape}. Make anchors with `duospacenet anchors --queries {num_queries}`."
        )
    _check_numbers(path, anchors)
    return torch.from_numpy(to_pose_vectors(anchors).astype(np.float32))


def to_pose_vectors(anchors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convert Sparse4D's anchors (N, 11) in the lidar frame to pose vectors (N, 10) in the ego frame."""
    rotation = rotation_from_quaternion(np.array(LIDAR_ROTATION))
    position, log_length, log_width, log_height, sin, cos, velocity = np.split(anchors, (3, 4, 5, 6, 7, 8), axis=1)
    heading = np.concatenate([cos, sin, np.zeros_like(sin)], axis=1) @ rotation.T
    moved = position @ rotation.T + np.array(LIDAR_TRANSLATION_M)
    # As in motion compensation, the z of a rotated heading and velocity is dropped.
    return np.concatenate(
        [moved, log_width, log_length, log_height, heading[:, 1::-1], (velocity @ rotation.T)[:, :2]], axis=1
    )


def _is_numpy(path: Path) -> bool:
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(len(_NUMPY_MAGIC)) == _NUMPY_MAGIC


def _read_numpy(path: Path) -> NDArray[np.float64]:
    if path.stat().st_size > _MAX_FILE_BYTES:
        raise CheckpointError(f"{path}: expected an array of anchors; got {path.stat().st_size} bytes.")
    try:
        array = np.load(path, allow_pickle=False)
    except (ValueError, EOFError, OSError) as error:
        raise CheckpointError(f"{path}: expected a NumPy array; it cannot be read ({error}). Copy it again.") from error
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiu":
        raise CheckpointError(f"{path}: expected an array of numbers; got {getattr(array, 'dtype', 'an archive')}.")
    return array.astype(np.float64)


def _read_checkpoint(path: Path) -> NDArray[np.float64]:
    content, _ = read_file(path)
    try:
        tensors = flatten_checkpoint(content).tensors
    except UnwrapError as error:
        raise CheckpointError(f"{path}: {error}.") from error
    # A head for maps, as in SparseDrive, has anchors with another number of columns.
    found = {
        name: tensor
        for name, tensor in tensors.items()
        if f".{name}".endswith(f".{_NAME}") and tensor.ndim == 2 and tensor.shape[1] == NUM_COLUMNS
    }
    if len(found) != 1:
        got = ", ".join(sorted(found)) or "none"
        raise CheckpointError(
            f"{path}: expected one tensor *.{_NAME} with {NUM_COLUMNS} columns, as in a checkpoint of Sparse4D; "
            f"got {got}."
        )
    (tensor,) = found.values()
    return tensor.double().numpy()


def _check_numbers(path: Path, anchors: NDArray[np.float64]) -> None:
    if not np.isfinite(anchors).all():
        raise CheckpointError(f"{path}: expected finite anchors; got NaN or Inf.")
    largest = np.abs(anchors[:, 3:6]).max()
    if largest > _LARGEST_LOG_SIZE:
        raise CheckpointError(
            f"{path}: expected logarithms of sizes [m] in columns 3 to 5, at most {_LARGEST_LOG_SIZE:g}; got "
            f"{largest:g}. Take the logarithm if they are sizes."
        )
    if (np.hypot(anchors[:, 6], anchors[:, 7]) < 1e-3).any():
        raise CheckpointError(f"{path}: expected sin and cos of a yaw in columns 6 and 7; got two zeros.")
