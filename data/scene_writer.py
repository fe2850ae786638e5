"""Writes frames as a scene folder: `scene.json` beside PNG images."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..runtime.errors import InputError, OutputError
from ..runtime.files import atomic_folder, write_atomically
from ..runtime.frame import Camera, Frame, GroundTruth
from ..runtime.printable import has_control_character
from ..runtime.validation import check_frame
from .images import write_png
from .scene_schema import CALIBRATION_FIELDS, SCENE_NAME, SCHEMA_VERSION


def write_scene(directory: Path | str, frames: Iterable[Frame]) -> None:
    """Write frames as a scene folder with PNG images. `directory` appears only when all frames are written.

    Raises OutputError if `directory` exists or cannot be written, and InputError for an invalid frame or no frames.
    Nothing remains on disk then.
    """
    directory = Path(directory)
    if directory.exists():
        raise OutputError(f"{directory}: expected a new folder; it exists already. Remove it, or choose another.")
    with atomic_folder(directory) as staging_dir:
        records = [_write_frame(staging_dir, index, frame) for index, frame in enumerate(frames)]
        if not records:
            raise InputError(f"{directory}: expected at least one frame to write; got none.")
        write_atomically(staging_dir / SCENE_NAME, _to_json(_share_calibration(records)).encode())


def _write_frame(folder: Path, index: int, frame: Frame) -> dict[str, Any]:
    """Write the images and masks of a frame. Returns its JSON record, with the calibration of every camera."""
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
        # 0 and 255, so that an image viewer shows the masks; the reader accepts any value above 0.
        masks = {name: mask.astype(np.uint8) * 255 for name, mask in frame.ground_truth.maps.items()}
        record["maps"] = {name: _write_png(folder, "maps", name, index, mask) for name, mask in masks.items()}
    return record


def _write_png(folder: Path, kind: str, name: str, index: int, image: NDArray[np.uint8] | None) -> str | None:
    """Write an image as `kind/name/index.png` and return that path; return None for no image."""
    if image is None:
        return None
    if name != Path(name).name or name.startswith("."):
        raise InputError(f"{kind}: expected names that are valid as folder names; got {name!r}. Rename it.")
    path = Path(kind) / name / f"{index:06d}.png"
    (folder / path).parent.mkdir(parents=True, exist_ok=True)
    write_png(folder / path, image)
    return path.as_posix()


def _calibration(camera: Camera) -> dict[str, Any]:
    return {
        "width_px": int(camera.width_px),
        "height_px": int(camera.height_px),
        "intrinsics_px": camera.intrinsics_px.tolist(),
        "camera_T_ego": camera.camera_T_ego.tolist(),
    }


def _boxes(index: int, ground_truth: GroundTruth) -> list[dict[str, Any]]:
    """Return the JSON records of boxes, under their mapped names. Raises InputError for numbers that are not valid."""
    if not np.isfinite(ground_truth.boxes[:, :7]).all():
        raise InputError(
            f"frame {index}: expected finite positions, sizes and yaws; got NaN or infinity. Leave such boxes out."
        )
    if (np.isfinite(ground_truth.boxes[:, 7]) != np.isfinite(ground_truth.boxes[:, 8])).any() or np.isinf(
        ground_truth.boxes
    ).any():
        raise InputError(
            f"frame {index}: expected finite velocities, or NaN twice if unknown; got another velocity. Correct it."
        )
    if names := [
        name for name in (*ground_truth.classes, *(ground_truth.attributes or ())) if has_control_character(name)
    ]:
        raise InputError(
            f"frame {index}: expected classes and attributes without control characters; got {names[0]!r}. Rename it."
        )
    num_points, attributes = ground_truth.num_points, ground_truth.attributes
    return [
        {
            "class": mapped,
            "center_m": box[:3],
            "size_wlh_m": box[3:6],
            "yaw_rad": box[6],
            "velocity_m_s": box[7:] if np.isfinite(box[7:]).all() else None,
            **({} if num_points is None or num_points[row] < 0 else {"num_points": int(num_points[row])}),
            **({} if attributes is None else {"attribute": attributes[row]}),
        }
        for row, (name, box) in enumerate(zip(ground_truth.classes, ground_truth.boxes.tolist(), strict=True))
        # The mapping belongs to one frame, but scene.json has one for all frames. So it is applied here.
        if (mapped := ground_truth.class_mapping.get(name, name)) is not None
    ]


def _share_calibration(records: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the scene of the frame records. Calibration and scene name are written once if all frames share them."""
    rigs = [
        [(name, {field: camera[field] for field in CALIBRATION_FIELDS}) for name, camera in record["cameras"].items()]
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
    """Return JSON text with one line per camera and one line per frame, so that a diff shows single frames."""
    lines = {name: json.dumps(value) for name, value in scene.items()}
    if "cameras" in scene:
        cameras = (f"{json.dumps(name)}: {json.dumps(camera)}" for name, camera in scene["cameras"].items())
        lines["cameras"] = "{\n  " + ",\n  ".join(cameras) + "\n }"
    lines["frames"] = "[\n  " + ",\n  ".join(map(json.dumps, scene["frames"])) + "\n ]"
    return "{\n " + ",\n ".join(f'"{name}": {value}' for name, value in lines.items()) + "\n}\n"
