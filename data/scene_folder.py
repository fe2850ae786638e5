"""A scene folder as a source: `scene.json` beside image files. Users convert their own recordings to this format."""

import copy
import os
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..runtime.bundle.preprocessing_record import Preprocessing
from ..runtime.errors import InputError
from ..runtime.frame import Camera, Frame, GroundTruth
from ..runtime.validation import check_frame
from .camera_image import check_camera_images, read_camera_images
from .class_names import count_unknown, unknown_names_error
from .images import check_mask_header, read_mask
from .scene_file import SceneFile
from .scene_records import Box, value_or
from .scene_schema import CALIBRATION_FIELDS, SCENE_NAME

UNKNOWN_VELOCITY = (np.nan, np.nan)


class NotASceneFolderError(InputError):
    """There is no scene folder at a path. Other InputErrors are about what is in one."""


class SceneFolder:
    """The frames of a scene folder. The images of a frame are read when the frame is requested."""

    def __init__(self, path: Path, checked: bool = True, allow_outside_files: bool = False) -> None:
        """Check all of `scene.json`. Its frames are read again when they are requested.

        path: the file or its folder.
        checked: False also accepts impossible calibrations and poses, and time stamps that are out of order, so that
            `check-rig` can report them. Missing fields and wrong types are still refused.
        allow_outside_files: also accept paths of images and masks that lead out of the folder. Symbolic links in the
            folder are always followed.

        Raises InputError, naming the file and the field, and NotASceneFolderError without a `scene.json`.
        """
        path = Path(path)
        if not path.exists():
            raise NotASceneFolderError(
                f"{path}: expected a scene folder, nuscenes:ROOT or synthetic:SEED[:FRAMES]; got no such path."
            )
        self.path = path / SCENE_NAME if path.is_dir() else path
        if not self.path.exists():
            hint = f" For a nuScenes root, write nuscenes:{path}." if any(path.glob("v1.0-*")) else ""
            raise NotASceneFolderError(
                f"{path}: expected a scene folder, with {SCENE_NAME} in it; got a folder without it.{hint}"
            )
        if (self.path.parent / "sample_data.json").exists():  # has a scene.json too, which is a table
            folder = self.path.parent.resolve()
            raise NotASceneFolderError(
                f"{path}: expected a scene folder; got the tables of a nuScenes root. "
                f"Write nuscenes:{folder.parent}@{folder.name}."
            )
        self._file = SceneFile(self.path)
        if not allow_outside_files:
            self._check_paths()
        if checked:
            self._check()
        self._preprocessing: Preprocessing | None = None

    def with_fast_decoding(self, preprocessing: Preprocessing) -> "SceneFolder":
        """Return this source with JPEG files decoded at a half or a quarter of their size, where that is enough.

        preprocessing: of the bundle that gets the frames. The cameras of a frame describe its smaller images.
        """
        source = copy.copy(self)
        source._preprocessing = preprocessing
        return source

    @property
    def identity(self) -> str:
        """The sha256 of `scene.json`. Image files are assumed not to change while their names stay the same."""
        return f"{SCENE_NAME}, sha256 {self._file.sha256}"

    @property
    def tokens(self) -> Iterator[str]:
        return self._file.tokens()

    def __len__(self) -> int:
        return len(self._file)

    def __iter__(self) -> Iterator[Frame]:
        return map(self.frame, range(len(self)))

    def frame(self, index: int) -> Frame:
        """Read frame `index`, counted from 0, with its images. Raises InputError, naming the image file."""
        frame = self.frame_without_images(index)
        images, cameras = read_camera_images(self, index, frame.cameras, self._preprocessing)
        return replace(frame, images=images, cameras=cameras, ground_truth=self._ground_truth(index))

    def frame_without_images(self, index: int) -> Frame:
        """Return frame `index` without images and ground truth: only the values in `scene.json`.

        Raises InputError if a calibration field is given neither by the frame nor by the scene.
        """
        record = self._file.frame(index)
        names = dict.fromkeys((*value_or(self._file.header.cameras, {}), *record.cameras))
        return Frame(
            images=names,
            cameras={name: self._camera(index, name) for name in names},
            global_T_ego=np.array(record.global_T_ego, np.float64),
            timestamp_s=record.timestamp_s,
            scene=self.scene_name(index),
            token=value_or(record.token, ""),
        )

    def scene_name(self, index: int) -> str:
        """Return the scene of frame `index`."""
        return self._file.index.scene_name(index)

    def check_image_files(self, index: int) -> tuple[str, ...]:
        """Check the images and masks of frame `index` by their headers. Returns the names of the lost cameras.

        Raises InputError, naming the file, if one is missing, of another kind, or does not have the calibration's size.
        """
        lost = check_camera_images(self, index, self.frame_without_images(index).cameras)
        for mask in value_or(self._file.frame(index).maps, {}).values():
            check_mask_header(self.path.parent / mask)
        return lost

    def has_boxes(self, index: int) -> bool:
        """Return whether the boxes of frame `index` are known. A known list may be empty."""
        return bool(self._file.index.has_boxes[index])

    def has_maps(self, index: int) -> bool:
        """Return whether frame `index` has any ground-truth map."""
        return bool(self._file.index.has_maps[index])

    def map_names(self, index: int) -> frozenset[str]:
        """Return the names of the ground-truth maps of frame `index`."""
        return frozenset(value_or(self._file.frame(index).maps, {})) if self.has_maps(index) else frozenset()

    def ground_truth_without_maps(self, index: int) -> GroundTruth | None:
        """Return the ground truth of frame `index` without its maps; None if its boxes are unknown."""
        if not self.has_boxes(index):
            return None
        boxes = value_or(self._file.frame(index).boxes, ())
        return GroundTruth(
            boxes=_box_rows(boxes),
            classes=tuple(box.name for box in boxes),
            num_points=np.array([value_or(box.num_points, -1) for box in boxes], np.int64),
            attributes=_attributes(boxes),
            class_mapping=self._class_mapping,
        )

    def check_class_names(self, classes: Collection[str]) -> None:
        """Check that all annotated names stand for a class or are left out. Raises InputError that lists the others."""
        names = self._file.index.box_names.elements()
        if unknown := count_unknown(names, classes, self._class_mapping):
            raise unknown_names_error(str(self.path), unknown, classes, self._class_mapping)

    def image_path(self, index: int, name: str) -> Path | None:
        """Return the image path of camera `name` in frame `index`, which may not exist; None for a lost camera."""
        record = self._file.frame(index).cameras.get(name)
        return None if record is None or record.image is None else self.path.parent / record.image

    @property
    def _class_mapping(self) -> dict[str, str | None]:
        return value_or(self._file.header.class_mapping, {})

    def _check_paths(self) -> None:
        """Check that no path of an image or mask leads out of the folder, as a stranger's `scene.json` could."""
        folder = self.path.parent.absolute()
        for index in range(self._file.index.suspects.first_path, len(self)):
            frame = self._file.frame(index)
            images = {f"cameras.{name}.image": camera.image for name, camera in frame.cameras.items()}
            masks = {f"maps.{name}": mask for name, mask in value_or(frame.maps, {}).items()}
            for field, path in (images | masks).items():
                if path is not None and _leads_outside(folder, path):
                    remedy = f"Copy or link the file into the folder, or give trusted:{self.path.parent} as the source"
                    raise self._error(index, field, f"expected a path inside the scene folder; got {path!r}. {remedy}")

    def _check(self) -> None:
        """Check the frames as the runtime does: time order, calibrations and poses."""
        suspects = range(self._file.index.suspects.first_number, len(self))
        last = self.frame_without_images(suspects[0] - 1) if suspects and suspects[0] else None
        for index in suspects:
            frame = self.frame_without_images(index)
            if not frame.cameras:
                raise self._error(index, "cameras", "expected at least one, here or in the scene's cameras; got none")
            try:
                check_frame(frame, num_cameras=len(frame.cameras))
            except InputError as error:
                raise InputError(f"{self.path}: field frames.{index}: {error}") from None
            if last is not None and frame.scene == last.scene and frame.timestamp_s <= last.timestamp_s:
                message = f"expected later than {last.timestamp_s!r} of the frame before; got {frame.timestamp_s!r}"
                raise self._error(index, "timestamp_s", message)
            last = frame

    def _camera(self, index: int, name: str) -> Camera:
        """Return a camera's calibration in a frame. Each field is the frame's own, or else the scene's."""
        records = (self._file.frame(index).cameras.get(name), value_or(self._file.header.cameras, {}).get(name))
        fields: dict[str, Any] = {}
        for field in CALIBRATION_FIELDS:
            values = (value_or(getattr(record, field, None), None) for record in records)
            fields[field] = next((value for value in values if value is not None), None)
            if fields[field] is None:
                raise self._error(
                    index, f"cameras.{name}.{field}", f"expected a value here or in cameras.{name}; got neither"
                )
        return Camera(
            intrinsics_px=np.array(fields["intrinsics_px"], np.float64),
            camera_T_ego=np.array(fields["camera_T_ego"], np.float64),
            width_px=fields["width_px"],
            height_px=fields["height_px"],
        )

    def _ground_truth(self, index: int) -> GroundTruth | None:
        if not self.has_boxes(index) and not self.has_maps(index):
            return None
        paths = value_or(self._file.frame(index).maps, {})
        maps = {name: read_mask(self.path.parent / mask) for name, mask in paths.items()}
        with_boxes = self.ground_truth_without_maps(index)
        if with_boxes is None:
            return GroundTruth(_box_rows(()), (), maps, has_boxes=False)
        return replace(with_boxes, maps=maps)

    def _error(self, index: int, field: str, message: str) -> InputError:
        return InputError(f"{self.path}: field frames.{index}.{field}: {message}.")


def _leads_outside(folder: Path, path: str) -> bool:
    """Whether a path of `scene.json` is outside its folder by its text. Links are not resolved."""
    return not Path(os.path.normpath(folder / path)).is_relative_to(os.path.normpath(folder))


def _attributes(boxes: Sequence[Box]) -> tuple[str, ...] | None:
    """Return the attribute of each box, "" where it is unknown; None if those of all boxes are unknown."""
    if boxes and all(value_or(box.attribute, None) is None for box in boxes):
        return None
    return tuple(value_or(box.attribute, "") for box in boxes)


def _box_rows(boxes: Iterable[Box]) -> NDArray[np.float64]:
    """Return boxes (D, 9): x y z w l h yaw vx vy, with NaN for an unknown velocity."""
    rows = [[*box.center_m, *box.size_wlh_m, box.yaw_rad, *(box.velocity_m_s or UNKNOWN_VELOCITY)] for box in boxes]
    return np.array(rows, np.float64).reshape(-1, 9)
