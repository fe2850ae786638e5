"""Recordings for the rerun viewer: an .rrd file with a blueprint. Needs the extra `rerun`.

Entities: `world/ego` with a pose per frame; inside it `cameras/NAME` with calibration and image, `detections`,
`ground_truth` and `map/NAME`. Rerun's poses are float32, so the world begins at the first ego position. The timelines
are `time` and `frame`.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from ..runtime.files import output_errors
from ..runtime.frame import Frame
from ..runtime.geometry import inverse, quaternion_from_rotation, rotation_z
from ..runtime.printable import printable
from .frame_picture import camera_rows
from .piped_file import PipedFile
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
    to_square_cells,
)

Array = NDArray[np.float64]

WORLD, EGO = "world", "world/ego"
CAMERAS, DETECTIONS, GROUND_TRUTH, MAP = (f"{EGO}/{name}" for name in ("cameras", "detections", "ground_truth", "map"))
MAP_OPACITY = 0.6
LINE_PX = 1.5
IMAGE_PLANE_M = 2.0
EYE_M, EYE_TARGET_M = (-30.0, 0.0, 25.0), (6.0, 0.0, 0.0)  # behind and above the ego


class RerunRecording:
    """An .rrd file that is being written."""

    def __init__(self, temporary: Path, path: Path) -> None:
        """temporary: the new file. path: its later name, for messages. Raises OutputError if it cannot be opened."""
        self._path = path
        with output_errors(path):
            self._file = PipedFile(temporary)
        # Without the times of this process, which say nothing about the frames.
        self._recording = rr.RecordingStream(APPLICATION, send_properties=False)
        self._recording.set_log_time_enabled(False)
        self._recording.save(self._file.pipe_path)
        self._origin_m: Array | None = None
        self._num_frames = 0

    def add(self, recorded: RecordedFrame) -> None:
        """Append a frame. Raises OutputError if it cannot be written."""
        frame = recorded.frame
        if self._origin_m is None:
            self._origin_m = rigid(frame.global_T_ego)[:3, 3]
            self._recording.log(WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
            self._recording.send_blueprint(_blueprint(frame))
        self._recording.set_time("time", timestamp=np.datetime64(nanoseconds(frame.timestamp_s), "ns"))
        self._recording.set_time("frame", sequence=self._num_frames)
        self._add_pose(EGO, rigid(frame.global_T_ego), self._origin_m)
        self._recording.log("frame", rr.TextLog(f"{printable(frame.scene)} {printable(frame.token)}"))
        for name in frame.cameras:
            self._add_camera(frame, name)
        self._add_boxes(DETECTIONS, recorded.boxes)
        if recorded.ground_truth is not None:
            self._add_boxes(GROUND_TRUTH, recorded.ground_truth)
        for name, mask in recorded.maps.items():
            self._add_map(name, recorded, to_square_cells(mask, recorded.map_area))
        self._num_frames += 1
        self._recording.flush()
        with output_errors(self._path):
            self._file.check()

    def close(self) -> None:
        """Complete the file. Raises OutputError if that fails."""
        self._recording.disconnect()
        with output_errors(self._path):
            self._file.close()

    def _add_pose(self, path: str, parent_T_child: Array, origin_m: Array | None = None) -> None:
        translation_m = parent_T_child[:3, 3] - (0 if origin_m is None else origin_m)
        self._recording.log(path, rr.Transform3D(translation=translation_m, mat3x3=parent_T_child[:3, :3]))

    def _add_camera(self, frame: Frame, name: str) -> None:
        camera, image, path = frame.cameras[name], frame.images.get(name), camera_path(name)
        self._add_pose(path, inverse(rigid(camera.camera_T_ego)))
        pinhole = rr.Pinhole(
            image_from_camera=scaled_intrinsics(camera, image),
            resolution=image_size(camera, image),
            camera_xyz=rr.ViewCoordinates.RDF,
            image_plane_distance=IMAGE_PLANE_M,
        )
        self._recording.log(path, pinhole)
        # A lost camera must not keep the image of an earlier frame.
        content = rr.Clear(recursive=False) if image is None else _image(image)
        self._recording.log(f"{path}/image", content)

    def _add_boxes(self, path: str, boxes: RecordedBoxes) -> None:
        colours = [colour[::-1] for colour in boxes.colours]
        quaternions = [_xyzw(rotation_z(float(yaw))) for yaw in boxes.yaws_rad]
        self._recording.log(
            f"{path}/boxes",
            rr.Boxes3D(
                centers=boxes.centres_m,
                sizes=boxes.sizes_m,
                quaternions=np.array(quaternions).reshape(-1, 4),
                colors=colours,
                labels=boxes.labels,
                radii=rr.Radius.ui_points(LINE_PX),
                fill_mode="majorwireframe",
                show_labels=path == DETECTIONS,  # those of the ground truth would hide them
            ),
        )
        velocities = np.column_stack([np.nan_to_num(boxes.velocities_m_s), np.zeros(len(boxes.labels))])
        arrows = rr.Arrows3D(
            origins=boxes.centres_m, vectors=velocities, colors=colours, radii=rr.Radius.ui_points(LINE_PX)
        )
        self._recording.log(f"{path}/velocities", arrows)

    def _add_map(self, name: str, recorded: RecordedFrame, mask: NDArray[np.uint8]) -> None:
        area = recorded.map_area
        pixels = np.ascontiguousarray(map_pixels(name, mask)[::-1])  # rerun's first row is at the highest y
        grid = rr.GridMap(
            data=pixels.tobytes(),
            format=rr.components.ImageFormat(
                width=pixels.shape[1], height=pixels.shape[0], color_model="RGBA", channel_datatype="U8"
            ),
            cell_size=float(cell_size(mask, area)[0]),
            translation=[*area.lower_m, 0.0],
            opacity=MAP_OPACITY,
        )
        self._recording.log(f"{MAP}/{_part(name)}", grid)


def camera_path(name: str) -> str:
    """The entity of a camera."""
    return f"{CAMERAS}/{_part(name)}"


def _image(image: NDArray[np.uint8]) -> rr.EncodedImage:
    return rr.EncodedImage(contents=encode_jpeg(image), media_type="image/jpeg")


def _part(name: str) -> str:
    """A name as one part of an entity path."""
    return rr.escape_entity_path_part(printable(name))


def _xyzw(rotation: Array) -> list[float]:
    w, x, y, z = quaternion_from_rotation(rotation).tolist()
    return [x, y, z, w]


def _blueprint(frame: Frame) -> rrb.Blueprint:
    """The camera images in two rows beside the 3D view, with the boxes in all of them."""
    rows = [
        rrb.Horizontal(contents=[_camera_view(frame, name) for name in row])
        for row in camera_rows(frame.cameras)
        if row
    ]
    eye = rrb.EyeControls3D(position=EYE_M, look_target=EYE_TARGET_M, eye_up=(0, 0, 1))
    above = rrb.Spatial3DView(origin=EGO, name="3D", eye_controls=eye)
    views: Sequence[rrb.Vertical | rrb.Spatial3DView] = [rrb.Vertical(contents=rows), above] if rows else [above]
    layout = rrb.Horizontal(contents=views, column_shares=[3, 2][-len(views) :])
    return rrb.Blueprint(layout, rrb.TimePanel(state="collapsed", timeline="time"), collapse_panels=True)


def _camera_view(frame: Frame, name: str) -> rrb.Spatial2DView:
    """The image of a camera with the boxes, which may reach beyond it."""
    width, height = image_size(frame.cameras[name], frame.images.get(name))
    bounds = rrb.VisualBounds2D(x_range=(0, width), y_range=(0, height))
    boxes = [f"{path}/boxes" for path in (DETECTIONS, GROUND_TRUTH)]
    contents = ["$origin/**", *boxes]
    return rrb.Spatial2DView(origin=camera_path(name), contents=contents, name=printable(name), visual_bounds=bounds)
