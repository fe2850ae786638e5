"""Comparison: pictures of several results beside one ground truth."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..data.box_selection import select_boxes
from ..data.class_names import DETECTION_CLASSES
from ..data.images import write_png
from ..drawing.comparison_picture import (
    Comparison,
    NamedBoxes,
    draw_comparison_above,
    draw_comparison_in_cameras,
)
from ..drawing.frame_picture import camera_rows
from ..evaluation.found_objects import find_objects
from ..runtime.errors import OutputError, UsageError
from ..runtime.frame import Frame, GroundTruth
from ..runtime.printable import printable, shortened
from ..runtime.progress import Progress, no_progress
from .compared_results import (
    ComparedResults,
    FrameBoxes,
    FrameKey,
    check_pose,
    choose_frames,
    frame_keys,
    read_compared,
)
from .output_folder import check_not_source, check_writable, make_folders
from .prefetch import prefetch
from .sources import SourceNames, open_sources, source_names

ABOVE, CAMERAS = "above", "cameras"


@dataclass(frozen=True)
class ComparisonPictures:
    """The pictures of a comparison.

    names: of the results, as the pictures show them.
    frames: indices of the compared frames in the sources.
    """

    out: Path
    names: tuple[str, ...]
    frames: tuple[int, ...]

    def to_dict(self) -> dict[str, object]:
        """The fields as JSON values."""
        return {"out": str(self.out), "names": list(self.names), "frames": list(self.frames)}


def compare(
    results: Sequence[str | Path],
    sources: SourceNames,
    out: str | Path,
    *,
    frames: Sequence[str] = (),
    cameras: Sequence[str] = (),
    names: Sequence[str] = (),
    min_score: float = 0.3,
    ellipses: bool = False,
    range_m: float = 51.2,
    progress: Progress = no_progress,
) -> ComparisonPictures:
    """Draw several results beside the ground truth of their sources, two pictures per frame.

    `above/000000.png` has one bird's-eye view per result, `cameras/000000.png` one row of camera images per result.
    The number is the index of the frame in the sources.

    results: folders of `run`, or their `results.jsonl`.
    sources: one or several, as these runs had them. Their ground truth is drawn where it is known.
    out: a new or empty folder.
    frames: tokens, or indices counted from 0; all frames of the results by default.
    cameras: names of the cameras, from left to right; all by default.
    names: one per result; the names of the folders by default.
    min_score: boxes with a lower score are not drawn, 0 to 1.
    ellipses: mark the true objects that some of the results contain and others do not.
    range_m: of the views from above, from the ego.
    Raises UsageError, InputError or OutputError before anything is written if the results do not belong together.
    """
    out = Path(out)
    _check_new(out)
    compared = read_compared([Path(path) for path in results], names, min_score)
    opened = open_sources(sources, progress=progress)
    for name in source_names(sources):
        check_not_source(out, name)
    if ellipses:
        opened.check_class_names(DETECTION_CLASSES)
    keys = frame_keys(opened)
    indices = choose_frames(keys, frames, compared)
    for index in indices:
        without_images = opened.frame_without_images(index)
        _check_cameras(cameras, without_images)
        for each in compared:
            check_pose(each, keys[index], without_images)
    make_folders(out, [ABOVE, CAMERAS])
    with prefetch(opened.frame, indices) as loaded:
        for index, frame in zip(progress(indices, "compare"), loaded, strict=True):
            comparison = _comparison(compared, keys[index], frame, ellipses)
            write_png(out / ABOVE / f"{index:06d}.png", draw_comparison_above(comparison, range_m))
            if row := list(cameras) or [name for part in camera_rows(frame.cameras) for name in part]:
                write_png(out / CAMERAS / f"{index:06d}.png", draw_comparison_in_cameras(comparison, frame, row))
    return ComparisonPictures(out, tuple(each.name for each in compared), tuple(indices))


def _comparison(compared: Sequence[ComparedResults], key: FrameKey, frame: Frame, ellipses: bool) -> Comparison:
    boxes = [each.frames[key] for each in compared]
    truth = frame.ground_truth if frame.ground_truth is not None and frame.ground_truth.has_boxes else None
    marked = disputed_boxes(truth, boxes) if ellipses and truth is not None else np.zeros((0, 9))
    named = [NamedBoxes(each.name, part.boxes) for each, part in zip(compared, boxes, strict=True)]
    return Comparison(named, truth, marked, _caption(key, truth))


def disputed_boxes(ground_truth: GroundTruth, results: Sequence[FrameBoxes]) -> NDArray[np.float64]:
    """Return the true boxes (M, 9) that some of the results contain and others do not.

    A result contains a true object if one of its boxes has the same class and a centre within 2 m in x and y.
    """
    truth = select_boxes(ground_truth, DETECTION_CLASSES)
    found = np.array(
        [find_objects(truth.boxes, truth.classes, each.boxes, each.scores, each.classes) for each in results], np.bool_
    )
    return truth.boxes[found.any(axis=0) & ~found.all(axis=0)]


def _caption(key: FrameKey, ground_truth: GroundTruth | None) -> str:
    count = "" if ground_truth is None else f"{len(ground_truth.classes)} true boxes"
    return ", ".join(part for part in (printable(key.scene), printable(key.token), count) if part)


def _check_new(out: Path) -> None:
    check_writable(out)
    if out.exists() and any(out.iterdir()):
        raise OutputError(f"{out}: expected a new or empty folder; it has files. Choose another --out.")


def _check_cameras(cameras: Sequence[str], frame: Frame) -> None:
    unknown = [name for name in cameras if name not in frame.cameras]
    if unknown:
        raise UsageError(f"--camera: expected {', '.join(map(printable, frame.cameras))}; got {shortened(unknown[0])}.")
