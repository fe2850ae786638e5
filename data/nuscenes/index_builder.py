"""Builds the index of one version of a nuScenes root from its tables."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...runtime.calibration_limits import are_intrinsics_possible
from ...runtime.garbage_collection import garbage_collection_paused
from ...runtime.progress import Progress, no_progress
from .annotation_tables import Annotations, read_annotations
from .frame_tables import Frames, SceneName, read_frames
from .image_tables import Images, read_images
from .index_records import FRAME, IMAGE, INDEX_FORMAT, Index, IndexSummary, SceneIndex, SceneSummary
from .table import row_error
from .table_set import TableSet, read_stamps


def build_index(folder: Path, progress: Progress = no_progress) -> Index:
    """Read and check the tables in the version folder.

    Raises InputError for a table that is missing, damaged or inconsistent, with the table, the row and the token.
    """
    stamps = read_stamps(folder)
    with garbage_collection_paused():
        tables = TableSet(folder, progress)
        frames = read_frames(tables)
        images = read_images(tables, frames)
        _check_times(frames, images)
        annotations = read_annotations(tables, frames, images.frame_poses)
    scenes = [
        _scene_index(slice(*frames.scene_starts[number : number + 2]), images, annotations)
        for number in range(len(frames.scenes))
    ]
    summary = IndexSummary(
        index_format=INDEX_FORMAT,
        stamps=stamps,
        sha256=tables.sha256,
        has_annotations=len(annotations.boxes) > 0,
        cameras=images.camera_names,
        categories=annotations.categories,
        attributes=annotations.attributes,
        scenes=[
            _summary(name, scene, len(annotations.categories))
            for name, scene in zip(frames.scenes, scenes, strict=True)
        ],
    )
    return Index(summary, scenes, _to_bytes(frames.tokens))


def _check_times(frames: Frames, images: Images) -> None:
    """Check that the times of the poses have the order of the samples, which are sorted within a scene."""
    is_first = np.isin(np.arange(1, len(frames.tokens)), frames.scene_starts)
    wrong = np.flatnonzero((np.diff(images.frame_times_us) <= 0) & ~is_first) + 1
    if len(wrong):
        number = int(wrong[0])
        times = [f"{time:.0f}" for time in images.frame_times_us[number - 1 : number + 1]]
        raise row_error(
            frames.path,
            frames.places[number],
            f"expected its lidar key frame later than {times[0]} us of the sample before; got {times[1]} us",
        )


def _scene_index(frames: slice, images: Images, annotations: Annotations) -> SceneIndex:
    """Return the index of the scene that has these frames."""
    image_rows = slice(*np.searchsorted(images.frames, (frames.start, frames.stop)))
    box_rows = slice(*np.searchsorted(annotations.frames, (frames.start, frames.stop)))
    frame_numbers = np.arange(frames.start, frames.stop)
    frame_array = np.zeros(len(frame_numbers), FRAME)
    frame_array["timestamp_s"] = 1e-6 * images.frame_times_us[frames]
    frame_array["translation"] = images.frame_poses.translations[frames]
    frame_array["rotation"] = images.frame_poses.rotations[frames]
    frame_array["images_end"] = np.searchsorted(images.frames[image_rows], frame_numbers, side="right")
    frame_array["boxes_end"] = np.searchsorted(annotations.frames[box_rows], frame_numbers, side="right")
    used, calibrations = np.unique(images.calibration_numbers[image_rows], return_inverse=True)
    image_array = np.zeros(len(calibrations), IMAGE)
    image_array["camera"] = images.cameras[image_rows]
    image_array["calibration"] = calibrations
    image_array["translation"] = images.image_poses.translations[image_rows]
    image_array["rotation"] = images.image_poses.rotations[image_rows]
    return SceneIndex(
        frame_array,
        image_array,
        _to_bytes(images.file_names[image_rows]),
        images.calibrations[used],
        annotations.boxes[box_rows],
    )


def _summary(name: SceneName, scene: SceneIndex, num_categories: int) -> SceneSummary:
    sizes = np.stack([scene.calibrations["width_px"], scene.calibrations["height_px"]], axis=1)
    return SceneSummary(
        name=name.name,
        location=name.location,
        num_frames=len(scene.frames),
        box_counts=np.bincount(scene.boxes["category"], minlength=num_categories).tolist(),
        has_possible_intrinsics=bool(are_intrinsics_possible(scene.calibrations["intrinsics_px"], sizes).all()),
    )


def _to_bytes(texts: list[str]) -> NDArray[np.bytes_]:
    return np.array([text.encode() for text in texts], dtype="S" if texts else "S1")
