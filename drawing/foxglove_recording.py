"""Recordings for Foxglove: an MCAP file with Foxglove's messages. Needs the extra `mcap`.

Topics: `/tf` with the frames global, ego and cameras; `/NAME/image` and `/NAME/calibration` of each camera;
`/detections`, `/ground_truth` and `/map/NAME` in the ego frame.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import foxglove
import numpy as np
from foxglove import channels
from foxglove.mcap import MCAPWriteOptions
from foxglove.messages import (
    ArrowPrimitive,
    CameraCalibration,
    Color,
    CompressedImage,
    CubePrimitive,
    FrameTransform,
    FrameTransforms,
    Grid,
    PackedElementField,
    PackedElementFieldNumericType,
    Pose,
    Quaternion,
    SceneEntity,
    SceneEntityDeletion,
    SceneEntityDeletionType,
    SceneUpdate,
    TextPrimitive,
    Timestamp,
    Vector2,
    Vector3,
)
from numpy.typing import NDArray

from ..runtime.frame import Frame
from ..runtime.geometry import inverse, quaternion_from_rotation, rotation_z
from ..runtime.printable import printable
from .canvas import Colour
from .checked_file import CheckedFile
from .recorded_frame import (
    APPLICATION,
    RecordedBoxes,
    RecordedFrame,
    cell_size,
    encode_jpeg,
    image_size,
    map_pixels,
    nanoseconds,
    rigid,
    scaled_intrinsics,
)

Array = NDArray[np.float64]

GLOBAL_FRAME, EGO_FRAME = "global", "ego"
TEXT_HEIGHT_M = 0.8
ARROW_HEAD_M, ARROW_WIDTH_M = 0.6, 0.15
SLOWEST_ARROW_M_S = 0.3
BOX_OPACITY = 0.5
GRID_FIELDS = ("red", "green", "blue", "alpha")


class FoxgloveRecording:
    """An MCAP file that is being written. Each frame's messages have its time stamp."""

    def __init__(self, temporary: Path, path: Path) -> None:
        """temporary: the new file. path: its later name, for messages. Raises OutputError if it cannot be opened."""
        self._file = CheckedFile(temporary, path)
        self._context = foxglove.Context()
        # Another number of threads would not change the content, and two cores are busy with inference.
        options = MCAPWriteOptions(profile=APPLICATION, compression_threads=0)
        self._writer = foxglove.open_mcap(self._file, context=self._context, writer_options=options)
        self._channels: dict[str, Any] = {}

    def add(self, recorded: RecordedFrame) -> None:
        """Append a frame. Raises OutputError if it cannot be written."""
        stamp_ns = nanoseconds(recorded.frame.timestamp_s)
        stamp = Timestamp(*divmod(stamp_ns, 10**9))
        self._log("/tf", channels.FrameTransformsChannel, _transforms(recorded.frame, stamp), stamp_ns)
        for name in recorded.frame.cameras:
            self._add_camera(recorded.frame, name, stamp, stamp_ns)
        scenes = {"/detections": recorded.boxes, "/ground_truth": recorded.ground_truth}
        for topic, boxes in scenes.items():
            if boxes is not None:
                self._log(topic, channels.SceneUpdateChannel, _scene(boxes, stamp), stamp_ns)
        for name, mask in recorded.maps.items():
            grid = _grid(map_pixels(name, mask), recorded.map_area.lower_m, cell_size(mask, recorded.map_area), stamp)
            self._log(f"/map/{printable(name)}", channels.GridChannel, grid, stamp_ns)
        self._file.check()

    def close(self) -> None:
        """Write the index. Raises OutputError if the file is not complete."""
        self._writer.close()
        self._file.check()
        self._file.close()

    def _add_camera(self, frame: Frame, name: str, stamp: Timestamp, stamp_ns: int) -> None:
        camera, image, topic = frame.cameras[name], frame.images.get(name), f"/{printable(name)}"
        width, height = image_size(camera, image)
        intrinsics_px = scaled_intrinsics(camera, image)
        intrinsics_px[:2, 2] -= 0.5  # the centre of Foxglove's first pixel is at (0, 0)
        calibration = CameraCalibration(
            timestamp=stamp,
            frame_id=frame_id(name),
            width=width,
            height=height,
            distortion_model="plumb_bob",
            D=[0.0] * 5,
            K=intrinsics_px.ravel().tolist(),
            R=np.eye(3).ravel().tolist(),
            P=np.column_stack([intrinsics_px, np.zeros(3)]).ravel().tolist(),
        )
        self._log(f"{topic}/calibration", channels.CameraCalibrationChannel, calibration, stamp_ns)
        if image is not None:
            message = CompressedImage(timestamp=stamp, frame_id=frame_id(name), data=encode_jpeg(image), format="jpeg")
            self._log(f"{topic}/image", channels.CompressedImageChannel, message, stamp_ns)

    def _log(self, topic: str, channel: Callable[..., Any], message: object, stamp_ns: int) -> None:
        if topic not in self._channels:
            self._channels[topic] = channel(topic, context=self._context)
        self._channels[topic].log(message, log_time=stamp_ns)


def frame_id(camera: str) -> str:
    """The name of a camera's frame: that of the camera, unless it is the name of another frame."""
    name = printable(camera)
    return f"camera_{name}" if name in (GLOBAL_FRAME, EGO_FRAME) else name


def _transforms(frame: Frame, stamp: Timestamp) -> FrameTransforms:
    poses = {(GLOBAL_FRAME, EGO_FRAME): rigid(frame.global_T_ego)}
    poses |= {(EGO_FRAME, frame_id(name)): inverse(rigid(each.camera_T_ego)) for name, each in frame.cameras.items()}
    transforms = [
        FrameTransform(
            timestamp=stamp,
            parent_frame_id=parent,
            child_frame_id=child,
            translation=_vector(parent_T_child[:3, 3]),
            rotation=_quaternion(parent_T_child[:3, :3]),
        )
        for (parent, child), parent_T_child in poses.items()
    ]
    return FrameTransforms(transforms=transforms)


def _scene(boxes: RecordedBoxes, stamp: Timestamp) -> SceneUpdate:
    """The boxes of one frame, which replace those of the frame before."""
    entities = [_entity(boxes, row, stamp) for row in range(len(boxes.labels))]
    return SceneUpdate(
        deletions=[SceneEntityDeletion(timestamp=stamp, type=SceneEntityDeletionType.All)], entities=entities
    )


def _entity(boxes: RecordedBoxes, row: int, stamp: Timestamp) -> SceneEntity:
    centre_m, size_m = boxes.centres_m[row], boxes.sizes_m[row]
    above_m = centre_m + np.array([0, 0, size_m[2] / 2 + TEXT_HEIGHT_M / 2])
    cube = CubePrimitive(
        pose=_pose(centre_m, rotation_z(float(boxes.yaws_rad[row]))),
        size=_vector(size_m),
        color=_colour(boxes.colours[row], BOX_OPACITY),
    )
    text = TextPrimitive(
        pose=_pose(above_m, np.eye(3)),
        billboard=True,
        font_size=TEXT_HEIGHT_M,
        color=_colour(boxes.colours[row], 1.0),
        text=boxes.labels[row],
    )
    return SceneEntity(
        timestamp=stamp,
        frame_id=EGO_FRAME,
        id=str(row),
        frame_locked=True,
        cubes=[cube],
        texts=[text],
        arrows=_arrows(centre_m, boxes.velocities_m_s[row], boxes.colours[row]),
    )


def _arrows(centre_m: Array, velocity_m_s: Array, colour: Colour) -> list[ArrowPrimitive]:
    """The motion of a box in one second; none for a slow box or an unknown velocity."""
    length_m = float(np.hypot(*velocity_m_s))
    if not length_m >= SLOWEST_ARROW_M_S:
        return []
    head_m = min(ARROW_HEAD_M, length_m / 2)
    arrow = ArrowPrimitive(
        pose=_pose(centre_m, rotation_z(float(np.arctan2(velocity_m_s[1], velocity_m_s[0])))),
        shaft_length=length_m - head_m,
        shaft_diameter=ARROW_WIDTH_M,
        head_length=head_m,
        head_diameter=3 * ARROW_WIDTH_M,
        color=_colour(colour, 1.0),
    )
    return [arrow]


def _grid(pixels: NDArray[np.uint8], corner_m: tuple[float, float], cell_m: Array, stamp: Timestamp) -> Grid:
    fields = [
        PackedElementField(name=name, offset=offset, type=PackedElementFieldNumericType.Uint8)
        for offset, name in enumerate(GRID_FIELDS)
    ]
    return Grid(
        timestamp=stamp,
        frame_id=EGO_FRAME,
        pose=_pose(np.array([*corner_m, 0.0]), np.eye(3)),
        column_count=pixels.shape[1],
        cell_size=Vector2(x=float(cell_m[0]), y=float(cell_m[1])),
        row_stride=pixels.shape[1] * len(GRID_FIELDS),
        cell_stride=len(GRID_FIELDS),
        fields=fields,
        data=pixels.tobytes(),
    )


def _pose(position_m: Array, rotation: Array) -> Pose:
    return Pose(position=_vector(position_m), orientation=_quaternion(rotation))


def _vector(values: Array) -> Vector3:
    return Vector3(x=float(values[0]), y=float(values[1]), z=float(values[2]))


def _quaternion(rotation: Array) -> Quaternion:
    w, x, y, z = quaternion_from_rotation(rotation).tolist()
    return Quaternion(x=x, y=y, z=z, w=w)


def _colour(colour: Colour, opacity: float) -> Color:
    blue, green, red = (channel / 255 for channel in colour)
    return Color(r=red, g=green, b=blue, a=opacity)
