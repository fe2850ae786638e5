"""The records of an index: what it keeps of the tables of one version, in numpy arrays by scene.

Poses are a translation [m] and a quaternion, w first, of any length.
"""

from typing import NamedTuple

import msgspec
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

INDEX_FORMAT = 1  # increased whenever the content of an index changes

_POSE = [("translation", np.float64, 3), ("rotation", np.float64, 4)]

# A key frame. images_end, boxes_end: the number of images and boxes of the scene up to and including this frame.
FRAME = np.dtype([("timestamp_s", np.float64), *_POSE, ("images_end", np.int32), ("boxes_end", np.int32)])
# An image of a key frame, with the ego pose at its own time. camera, calibration: row numbers.
IMAGE = np.dtype([("camera", np.int32), ("calibration", np.int32), *_POSE])
# The calibration of a camera: its pose is relative to the ego frame.
CALIBRATION = np.dtype([("intrinsics_px", np.float64, (3, 3)), *_POSE, ("width_px", np.int32), ("height_px", np.int32)])
# An annotation, in the ego frame of its key frame. attribute: row number, or -1 for none.
BOX = np.dtype([("box", np.float64, 9), ("category", np.int32), ("attribute", np.int32), ("num_points", np.int32)])


class SceneIndex(NamedTuple):
    """A scene: its frames in time order, their images and boxes, and the calibrations that its images name.

    file_names: (images,) paths relative to the root, as UTF-8.
    """

    frames: NDArray
    images: NDArray
    file_names: NDArray[np.bytes_]
    calibrations: NDArray
    boxes: NDArray


class SceneSummary(Struct, frozen=True):
    """box_counts: number of boxes of each category.

    has_possible_intrinsics: whether those of all cameras are within the limits of the runtime.
    """

    name: str
    location: str
    num_frames: int
    box_counts: list[int]
    has_possible_intrinsics: bool


class CategorySummary(Struct, frozen=True):
    """A row of the table of categories."""

    name: str
    token: str
    row: int


class IndexSummary(Struct, frozen=True):
    """What is read when an index is opened.

    index_format: `INDEX_FORMAT` of the toolkit that built it.
    stamps: size [bytes] and time of the last change [ns] of each table, by name.
    sha256: of the hashes of all tables.
    has_annotations: whether there is any; the boxes of all frames are unknown otherwise.
    cameras: names.
    scenes: in ascending order of their names.
    """

    index_format: int
    stamps: dict[str, tuple[int, int]]
    sha256: str
    has_annotations: bool
    cameras: list[str]
    categories: list[CategorySummary]
    attributes: list[str]
    scenes: list[SceneSummary]

    def to_array(self) -> NDArray[np.uint8]:
        return np.frombuffer(msgspec.msgpack.encode(self), np.uint8)

    @staticmethod
    def from_array(array: NDArray[np.uint8]) -> "IndexSummary":
        """Raises msgspec.MsgspecError for anything else than a summary."""
        return msgspec.msgpack.decode(array.tobytes(), type=IndexSummary)


class Index(NamedTuple):
    """All of an index.

    scenes: in the order of the summary.
    tokens: (frames,) sample tokens of all scenes, in the same order.
    """

    summary: IndexSummary
    scenes: list[SceneIndex]
    tokens: NDArray[np.bytes_]
