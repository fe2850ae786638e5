"""A scene folder: `scene.json` beside images; the format for anyone's own rig.

`scene.json` gives calibration once in `cameras`, or with each frame's own, field by field. A camera that the scene
calibrates and a frame does not mention is lost in that frame. Paths are relative to the folder of `scene.json`.
"""

import hashlib
import json
import shutil
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from ..runtime.errors import InputError, OutputError
from ..runtime.files import temporary_path, write_atomically
from ..runtime.frame import Camera, Frame, GroundTruth
from ..runtime.json_record import FiniteFloat, JsonRecord, PositiveFloat, PositiveInt, float64_array, read_json
from ..runtime.validation import check_frame
from .images import read_image, read_mask, write_png

SCHEMA_VERSION = 1
SCENE_NAME = "scene.json"
UNKNOWN_VELOCITY = (np.nan, np.nan)
CALIBRATION = ("width_px", "height_px", "intrinsics_px", "camera_T_ego")

Row3 = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Row4 = tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]
Matrix3 = tuple[Row3, Row3, Row3]
Matrix4 = tuple[Row4, Row4, Row4, Row4]


class CalibrationRecord(JsonRecord):
    """A camera whose calibration holds for the whole scene; the fields are those of `Camera`."""

    width_px: PositiveInt
    height_px: PositiveInt
    intrinsics_px: Matrix3
    camera_T_ego: Matrix4


class CameraRecord(JsonRecord):
    """A camera in one frame. image: a path, or null for a lost camera; the others override the scene's."""

    image: str | None
    width_px: PositiveInt | None = None
    height_px: PositiveInt | None = None
    intrinsics_px: Matrix3 | None = None
    camera_T_ego: Matrix4 | None = None


class BoxRecord(JsonRecord):
    """A known object in the ego frame of its frame; the velocity is over ground, or null where it is not known."""

    name: str = Field(alias="class")
    center_m: Row3
    size_wlh_m: tuple[PositiveFloat, PositiveFloat, PositiveFloat]
    yaw_rad: FiniteFloat
    velocity_m_s: tuple[FiniteFloat, FiniteFloat] | None


class FrameRecord(JsonRecord):
    """One frame. boxes and maps: the truth, where it is known; maps are PNG masks, row i at x_i, column j at y_j."""

    timestamp_s: FiniteFloat
    token: str = ""
    scene: str | None = None
    global_T_ego: Matrix4
    cameras: dict[str, CameraRecord]
    boxes: tuple[BoxRecord, ...] | None = None
    maps: dict[str, str] = Field(default_factory=dict)


class SceneRecord(JsonRecord):
    """`scene.json`."""

    schema_version: Literal[1]
    scene: str
    cameras: dict[str, CalibrationRecord] = Field(default_factory=dict)
    frames: Annotated[tuple[FrameRecord, ...], Field(min_length=1)]


class SceneFolder:
    """The frames of a scene folder; images are read when their frame's turn comes."""

    def __init__(self, path: Path, checked: bool = True) -> None:
        """Read and check all of `scene.json`; `path` is it or its folder.

        checked: False is for looking at a rig that may be broken: the fields must be there and of their kind, but
        the calibrations and poses may be impossible, and the times out of order.
        Raises InputError, naming the file and the field.
        """
        path = Path(path)
        if not path.exists():
            raise InputError(f"{path}: expected a scene folder, or synthetic:SEED[:FRAMES]; got no such path.")
        self.path = path / SCENE_NAME if path.is_dir() else path
        if not self.path.exists():
            raise InputError(f"{path}: expected a scene folder, with {SCENE_NAME} in it; got a folder without.")
        self._scene = read_json(self.path, SceneRecord, InputError)
        if checked:
            self._check()

    @property
    def identity(self) -> str:
        """The hash of `scene.json`; images are taken to be what they were."""
        return f"{SCENE_NAME}, sha256 {hashlib.sha256(self.path.read_bytes()).hexdigest()}"

    @property
    def tokens(self) -> Iterator[str]:
        return (frame.token for frame in self._scene.frames)

    def __len__(self) -> int:
        return len(self._scene.frames)

    def __iter__(self) -> Iterator[Frame]:
        return map(self.frame, range(len(self)))

    def frame(self, index: int) -> Frame:
        """Read frame `index`, counted from 0, with its images. Raises InputError, naming the image's path."""
        blind = self.frame_without_images(index)
        images: dict[str, NDArray[np.uint8] | None] = dict.fromkeys(blind.cameras)
        for name, calibration in blind.cameras.items():
            path = self.image_path(index, name)
            if path is not None:
                images[name] = read_image(path, calibration.width_px, calibration.height_px)
        return replace(blind, images=images, ground_truth=self._truth(index))

    def frame_without_images(self, index: int) -> Frame:
        """Frame `index` without its images and truth: everything that `scene.json` itself says.

        Raises InputError where a field of a calibration stands nowhere.
        """
        record = self._scene.frames[index]
        names = dict.fromkeys((*self._scene.cameras, *record.cameras))
        return Frame(
            images=names,
            cameras={name: self._camera(index, name) for name in names},
            global_T_ego=float64_array(record.global_T_ego),
            timestamp_s=record.timestamp_s,
            scene=self._scene.scene if record.scene is None else record.scene,
            token=record.token,
        )

    def has_boxes(self, index: int) -> bool:
        """Whether the true boxes of frame `index` are known, and be it that there are none."""
        return self._scene.frames[index].boxes is not None

    def ground_truth_boxes(self, index: int) -> NDArray[np.float64] | None:
        """The ground-truth boxes (D, 9) of frame `index`, without its images; None if they are unknown."""
        known = self._scene.frames[index].boxes
        return None if known is None else _box_rows(known)

    def image_path(self, index: int, name: str) -> Path | None:
        """Where the image of camera `name` in frame `index` should lie; None for a lost camera."""
        record = self._scene.frames[index].cameras.get(name)
        return None if record is None or record.image is None else self.path.parent / record.image

    def _check(self) -> None:
        """What the fields must be together: time order, and calibrations that a camera can have."""
        last: Frame | None = None
        for index in range(len(self)):
            frame = self.frame_without_images(index)
            if not frame.cameras:
                raise self._error(index, "cameras", "expected at least one, here or in the scene's cameras; got none")
            try:
                check_frame(frame, num_cameras=len(frame.cameras))
            except InputError as error:
                raise InputError(f"{self.path}: field frames.{index}: {error}") from None
            if last is not None and frame.scene == last.scene and frame.timestamp_s <= last.timestamp_s:
                expected = f"expected later than {last.timestamp_s!r} of the frame before; got {frame.timestamp_s!r}"
                raise self._error(index, "timestamp_s", expected)
            last = frame

    def _camera(self, index: int, name: str) -> Camera:
        """A camera's calibration in a frame: each field the frame's own, or else the scene's."""
        records = (self._scene.frames[index].cameras.get(name), self._scene.cameras.get(name))
        fields: dict[str, Any] = {}
        for field in CALIBRATION:
            values = (getattr(record, field, None) for record in records)
            fields[field] = next((value for value in values if value is not None), None)
            if fields[field] is None:
                raise self._error(index, f"cameras.{name}.{field}", f"expected here, or in cameras.{name}; got neither")
        return Camera(
            intrinsics_px=float64_array(fields["intrinsics_px"]),
            camera_T_ego=float64_array(fields["camera_T_ego"]),
            width_px=fields["width_px"],
            height_px=fields["height_px"],
        )

    def _truth(self, index: int) -> GroundTruth | None:
        record = self._scene.frames[index]
        if record.boxes is None and not record.maps:
            return None
        known = record.boxes or ()
        return GroundTruth(
            boxes=_box_rows(known),
            classes=tuple(box.name for box in known),
            maps={name: read_mask(self.path.parent / mask) for name, mask in record.maps.items()},
            has_boxes=self.has_boxes(index),
        )

    def _error(self, index: int, field: str, message: str) -> InputError:
        return InputError(f"{self.path}: field frames.{index}.{field}: {message}.")


def write_scene(directory: Path | str, frames: Iterable[Frame]) -> None:
    """Write frames as a scene folder with PNG images. `directory` appears when all of them are in it.

    Raises OutputError when something stands there or it cannot be written, InputError for frames that cannot be
    right; nothing is left behind then.
    """
    directory = Path(directory)
    if directory.exists():
        raise OutputError(f"{directory}: expected a new folder; it exists already. Remove it, or choose another.")
    staging_dir = temporary_path(directory)
    try:
        staging_dir.mkdir(parents=True)
        records = [_write_frame(staging_dir, index, frame) for index, frame in enumerate(frames)]
        if not records:
            raise InputError(f"{directory}: expected at least one frame to write; got none.")
        write_atomically(staging_dir / SCENE_NAME, _to_json(_share_calibration(records)).encode())
        staging_dir.rename(directory)
    except OSError as error:
        raise OutputError(f"{directory}: cannot be written ({error.strerror}).") from error
    finally:
        shutil.rmtree(staging_dir, ignore_errors=True)


def _write_frame(folder: Path, index: int, frame: Frame) -> dict[str, Any]:
    """Write the images and masks of a frame; returns its record, with every camera's calibration."""
    check_frame(frame, num_cameras=len(frame.cameras))
    record: dict[str, Any] = {
        "timestamp_s": float(frame.timestamp_s),
        "token": frame.token,
        "scene": frame.scene,
        "global_T_ego": frame.global_T_ego.tolist(),
        "cameras": {},
    }
    for name, camera in frame.cameras.items():
        image = _write_png(folder, "images", name, index, frame.images[name])
        record["cameras"][name] = {"image": image, **_calibration(camera)}
    if frame.ground_truth is not None:
        record["boxes"] = _boxes(index, frame.ground_truth) if frame.ground_truth.has_boxes else None
        masks = {name: mask.astype(np.uint8) * 255 for name, mask in frame.ground_truth.maps.items()}
        record["maps"] = {name: _write_png(folder, "maps", name, index, mask) for name, mask in masks.items()}
    return record


def _write_png(folder: Path, kind: str, name: str, index: int, picture: NDArray[np.uint8] | None) -> str | None:
    """Write a picture as `kind/name/index.png` and return that path, or nothing for no picture."""
    if picture is None:
        return None
    if name != Path(name).name or name.startswith("."):
        raise InputError(f"{kind}: expected names that a folder can have; got {name!r}. Rename it.")
    path = Path(kind) / name / f"{index:06d}.png"
    (folder / path).parent.mkdir(parents=True, exist_ok=True)
    write_png(folder / path, picture)
    return path.as_posix()


def _box_rows(records: Iterable[BoxRecord]) -> NDArray[np.float64]:
    boxes = [[*box.center_m, *box.size_wlh_m, box.yaw_rad, *(box.velocity_m_s or UNKNOWN_VELOCITY)] for box in records]
    return float64_array(boxes).reshape(-1, 9)


def _calibration(camera: Camera) -> dict[str, Any]:
    return {
        "width_px": camera.width_px,
        "height_px": camera.height_px,
        "intrinsics_px": camera.intrinsics_px.tolist(),
        "camera_T_ego": camera.camera_T_ego.tolist(),
    }


def _boxes(index: int, ground_truth: GroundTruth) -> list[dict[str, Any]]:
    if not np.isfinite(ground_truth.boxes[:, :7]).all():
        raise InputError(f"frame {index}: expected finite places, sizes and yaws; got others. Leave such boxes out.")
    if (np.isfinite(ground_truth.boxes[:, 7]) != np.isfinite(ground_truth.boxes[:, 8])).any() or np.isinf(
        ground_truth.boxes
    ).any():
        raise InputError(f"frame {index}: expected velocities, or NaN twice where unknown; got others. Correct them.")
    return [
        {
            "class": name,
            "center_m": box[:3],
            "size_wlh_m": box[3:6],
            "yaw_rad": box[6],
            "velocity_m_s": box[7:] if np.isfinite(box[7:]).all() else None,
        }
        for name, box in zip(ground_truth.classes, ground_truth.boxes.tolist(), strict=True)
    ]


def _share_calibration(records: list[dict[str, Any]]) -> dict[str, Any]:
    """The scene of frame records, with what all frames agree on said once."""
    rigs = [
        [(name, {field: camera[field] for field in CALIBRATION}) for name, camera in record["cameras"].items()]
        for record in records
    ]
    scene = {"schema_version": SCHEMA_VERSION, "scene": records[0]["scene"]}
    if all(rig == rigs[0] for rig in rigs):
        scene["cameras"] = dict(rigs[0])
        for record in records:
            record["cameras"] = {name: {"image": camera["image"]} for name, camera in record["cameras"].items()}
    for record in records:
        if record["scene"] == scene["scene"]:
            del record["scene"]
    return scene | {"frames": records}


def _to_json(scene: dict[str, Any]) -> str:
    """JSON with a line a camera and a line a frame."""
    lines = {name: json.dumps(value) for name, value in scene.items()}
    if "cameras" in scene:
        cameras = (f"{json.dumps(name)}: {json.dumps(camera)}" for name, camera in scene["cameras"].items())
        lines["cameras"] = "{\n  " + ",\n  ".join(cameras) + "\n }"
    lines["frames"] = "[\n  " + ",\n  ".join(map(json.dumps, scene["frames"])) + "\n ]"
    return "{\n " + ",\n ".join(f'"{name}": {value}' for name, value in lines.items()) + "\n}\n"
