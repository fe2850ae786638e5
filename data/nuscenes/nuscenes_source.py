"""A nuScenes root as a source. Its tables are read through an index, and its images when a frame is requested."""

import copy
import hashlib
from collections.abc import Collection, Iterator
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...runtime.bundle.preprocessing_record import Preprocessing
from ...runtime.errors import InputError
from ...runtime.frame import Camera, Frame, GroundTruth
from ...runtime.geometry import inverse
from ...runtime.printable import shortened
from ...runtime.progress import Progress, no_progress
from ...runtime.validation import check_camera
from ..box_counts import number_of_boxes
from ..camera_image import check_camera_images, read_camera_images
from ..class_names import count_unknown
from ..mask_grid import MaskGrid
from .index_file import IndexFile, open_index, reopen_index
from .index_records import IndexSummary, SceneIndex
from .map_expansion import MAP_NAMES, MapExpansion
from .poses import rigid_transforms
from .root_name import parse_root_name
from .splits import choose_scenes

SCENES_IN_MEMORY = 8  # about 0.2 MB each


class NuscenesSource:
    """The key frames of a nuScenes root, scene by scene. The ego frame is at the time stamp of LIDAR_TOP.

    A copy of it, or what another process unpickles, opens the index file again when it needs it.

    root: the folder that file names are relative to.
    """

    def __init__(
        self,
        name: str,
        checked: bool = True,
        progress: Progress = no_progress,
        grid: MaskGrid | None = None,
    ) -> None:
        """Open `ROOT[@VERSION][/SPLIT]`. Builds the index first if these tables have none.

        checked: False also accepts impossible calibrations, so that `check-rig` can report them.
        progress: of building the index.
        grid: of the map masks. If None, or if the root has no folder `maps/expansion`, the frames have no maps.

        Raises InputError for an unknown root, version, split or scene, and for tables and maps that are missing,
        damaged or inconsistent; OutputError if the index cannot be written.
        """
        root_name = parse_root_name(name)
        self.root = root_name.root
        index = open_index(root_name.folder, progress)
        summary = index.summary
        scenes = choose_scenes(root_name.split, [scene.name for scene in summary.scenes], root_name.folder)
        numbers = {scene.name: number for number, scene in enumerate(summary.scenes)}
        self._scenes = np.array([numbers[scene] for scene in scenes], np.int64)
        self._ends = np.cumsum([summary.scenes[number].num_frames for number in self._scenes])
        self._folder, self._split = root_name.folder, root_name.split
        self._index_path, self._sha256 = index.path, summary.sha256
        self._preprocessing: Preprocessing | None = None
        self._opened: _OpenIndex | None = _OpenIndex(index)
        if not len(self):
            raise InputError(f"{self._folder}: expected frames in the chosen scenes; got none.")
        if checked:
            self._check_calibrations()
        self._grid = grid
        self._maps: MapExpansion | None = None
        if grid is not None and MapExpansion.is_installed(self.root):
            locations = (summary.scenes[number].location for number in self._scenes)
            self._maps = MapExpansion(self.root, locations, progress)

    def with_fast_decoding(self, preprocessing: Preprocessing) -> "NuscenesSource":
        """Return this source with JPEG files decoded at a half or a quarter of their size, where that is enough.

        preprocessing: of the bundle that gets the frames. The cameras of a frame describe its smaller images.
        """
        source = copy.copy(self)
        source._opened = self._opened
        source._preprocessing = preprocessing
        return source

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_opened": None}

    @property
    def identity(self) -> str:
        """The version, the split, and the sha256 of the tables and the scene names.

        Image files are assumed not to change while their names stay the same.
        """
        split = "" if self._split is None else f"/{self._split}"
        names = [self._summary.scenes[number].name for number in self._scenes]
        digest = hashlib.sha256("\n".join([self._sha256, *names]).encode()).hexdigest()
        return f"nuScenes {self._folder.name}{split}, sha256 {digest}"

    @property
    def tokens(self) -> Iterator[str]:
        """The sample tokens."""
        for number in self._scenes:
            yield from (token.decode() for token in self._index.tokens_of_scene(number).tolist())

    def __len__(self) -> int:
        return int(self._ends[-1]) if len(self._ends) else 0

    def __iter__(self) -> Iterator[Frame]:
        return map(self.frame, range(len(self)))

    def frame(self, index: int) -> Frame:
        """Read frame `index`, counted from 0, with its images. A camera without a file is lost.

        Raises InputError, naming the image file, if one is damaged or of another size.
        """
        frame = self.frame_without_images(index)
        images, cameras = read_camera_images(self, index, frame.cameras, self._preprocessing)
        return replace(frame, images=images, cameras=cameras, ground_truth=self._ground_truth(index, frame))

    def frame_without_images(self, index: int) -> Frame:
        """Return frame `index` without images and ground truth."""
        number, row = self._place(index)
        scene = self._index.scene(number)
        record = scene.frames[row]
        global_T_ego = rigid_transforms(record["translation"], record["rotation"])
        cameras = self._cameras(scene, row, global_T_ego)
        return Frame(
            images=dict.fromkeys(cameras),
            cameras=cameras,
            global_T_ego=global_T_ego,
            timestamp_s=float(record["timestamp_s"]),
            scene=self.scene_name(index),
            token=self._index.tokens_of_scene(number)[row].decode(),
        )

    def scene_name(self, index: int) -> str:
        """Return the scene of frame `index`."""
        return self._summary.scenes[self._place(index)[0]].name

    def check_image_files(self, index: int) -> tuple[str, ...]:
        """Check the image files of frame `index` by their headers. Returns the cameras without a file.

        Raises InputError, naming the file, if one is of another kind, or does not have the size in the tables.
        """
        return check_camera_images(self, index, self.frame_without_images(index).cameras)

    def image_path(self, index: int, name: str) -> Path | None:
        """Return the image path of camera `name` in frame `index`; None if there is no such file."""
        number, row = self._place(index)
        scene = self._index.scene(number)
        for image in _rows(scene.frames["images_end"], row):
            if self._summary.cameras[scene.images["camera"][image]] == name:
                path = self.root / scene.file_names[image].decode()
                return path if _exists(path) else None
        return None

    def has_boxes(self, index: int) -> bool:
        """Return whether the version has annotations. A frame of such a version may have none."""
        return self._summary.has_annotations

    def has_maps(self, index: int) -> bool:
        """Return whether the source was opened with a grid, and the root has maps."""
        return self._maps is not None

    def map_names(self, index: int) -> frozenset[str]:
        """Return the names of the maps, which are the same for all frames."""
        return frozenset(MAP_NAMES) if self.has_maps(index) else frozenset()

    def ground_truth_without_maps(self, index: int) -> GroundTruth | None:
        """Return the ground truth of frame `index` without its maps; None if the version has no annotations."""
        summary = self._summary
        if not summary.has_annotations:
            return None
        number, row = self._place(index)
        scene = self._index.scene(number)
        boxes = scene.boxes[_rows(scene.frames["boxes_end"], row)]
        names, attributes = summary.categories, (*summary.attributes, "")  # the last is number -1, for no attribute
        return GroundTruth(
            boxes=boxes["box"].copy(),
            classes=tuple(names[category].name for category in boxes["category"]),
            num_points=boxes["num_points"].astype(np.int64),
            attributes=tuple(attributes[attribute] for attribute in boxes["attribute"]),
        )

    def check_class_names(self, classes: Collection[str]) -> None:
        """Check that the categories of all boxes stand for a class or are left out.

        Raises InputError that lists the others, with their rows.
        """
        counts = np.array([self._summary.scenes[number].box_counts for number in self._scenes], np.int64).sum(axis=0)
        used = [pair for pair in zip(self._summary.categories, counts.tolist(), strict=True) if pair[1]]
        if unknown := count_unknown((category.name for category, _ in used), classes):
            listed = ", ".join(
                f"{shortened(category.name)} (row {category.row}, token {shortened(category.token)}, "
                f"{number_of_boxes(count)})"
                for category, count in used
                if category.name in unknown
            )
            raise InputError(
                f"{self._folder / 'category.json'}: expected the categories of nuScenes, or classes of the model "
                f"({', '.join(classes)}); got {listed}. Rename them in the table."
            )

    def _ground_truth(self, index: int, frame: Frame) -> GroundTruth | None:
        """Return the boxes and the maps of a frame; None if both are unknown."""
        boxes = self.ground_truth_without_maps(index)
        if self._maps is None or self._grid is None:
            return boxes
        location = self._summary.scenes[self._place(index)[0]].location
        maps = self._maps.masks(location, frame.global_T_ego, self._grid)
        without_boxes = GroundTruth(np.zeros((0, 9)), (), has_boxes=False)
        return replace(boxes or without_boxes, maps=maps)

    def _cameras(self, scene: SceneIndex, row: int, global_T_ego: NDArray[np.float64]) -> dict[str, Camera]:
        """Return the calibrations of a frame, each for the ego pose at the camera's own time.

        A camera without an image in this frame has the calibration of its first image in the scene.
        """
        rows = {scene.images["camera"][image]: image for image in _rows(scene.frames["images_end"], row)}
        cameras = {}
        for camera, first in zip(*np.unique(scene.images["camera"], return_index=True), strict=True):
            image = scene.images[rows.get(camera, first)]
            calibration = scene.calibrations[image["calibration"]]
            ego_T_camera = rigid_transforms(calibration["translation"], calibration["rotation"])
            global_T_camera = rigid_transforms(image["translation"], image["rotation"]) @ ego_T_camera
            camera_T_ego = inverse(global_T_camera) @ global_T_ego if camera in rows else inverse(ego_T_camera)
            cameras[self._summary.cameras[camera]] = Camera(
                intrinsics_px=calibration["intrinsics_px"].copy(),
                camera_T_ego=camera_T_ego,
                width_px=int(calibration["width_px"]),
                height_px=int(calibration["height_px"]),
            )
        return cameras

    def _check_calibrations(self) -> None:
        """Check the intrinsics of the chosen scenes as the runtime does. Raises InputError, naming the frame."""
        for first, number in zip([0, *self._ends[:-1].tolist()], self._scenes, strict=True):
            if not self._summary.scenes[number].has_possible_intrinsics:
                for index in range(first, first + self._summary.scenes[number].num_frames):
                    self._check_cameras(index)

    def _check_cameras(self, index: int) -> None:
        for name, camera in self.frame_without_images(index).cameras.items():
            try:
                check_camera(name, camera)
            except InputError as error:
                raise InputError(f"{self._folder}: frame {index}: {error}") from None

    def _place(self, index: int) -> tuple[int, int]:
        """Return the number of the scene of a frame, and the number of the frame in it."""
        if not 0 <= index < len(self):
            raise IndexError(index)
        chosen = int(np.searchsorted(self._ends, index, side="right"))
        start = int(self._ends[chosen - 1]) if chosen else 0
        return int(self._scenes[chosen]), index - start

    @property
    def _index(self) -> "_OpenIndex":
        if self._opened is None:
            self._opened = _OpenIndex(reopen_index(self._index_path, self._sha256))
        return self._opened

    @property
    def _summary(self) -> IndexSummary:
        return self._index.file.summary


class _OpenIndex:
    """An open index file with its most recently used scenes."""

    def __init__(self, file: IndexFile) -> None:
        self.file = file
        self.scene = lru_cache(SCENES_IN_MEMORY)(file.scene)
        self._tokens = file.tokens()
        self._ends = np.cumsum([scene.num_frames for scene in file.summary.scenes])

    def tokens_of_scene(self, number: int) -> NDArray[np.bytes_]:
        """Return the sample tokens of a scene, by its number in the summary."""
        return self._tokens[self._ends[number] - self.file.summary.scenes[number].num_frames : self._ends[number]]


def _exists(path: Path) -> bool:
    """Whether there is a file. True as well if that cannot be found out, so that reading it gives the reason."""
    try:
        return path.exists()
    except OSError:
        return True


def _rows(ends: NDArray[np.int32], row: int) -> range:
    """Return the row numbers that belong to frame `row`. ends: their number up to and including each frame."""
    return range(int(ends[row - 1]) if row else 0, int(ends[row]))
