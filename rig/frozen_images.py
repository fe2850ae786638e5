"""Frozen cameras: the same image in consecutive frames, although the vehicle moves."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..runtime.frame import Frame
from .findings import Finding, Verdict
from .motion_steps import distance_between_m, turn_between_rad
from .thumbnails import Thumbnail, is_same_image

# An exact copy is not a new exposure, whatever the motion. The vehicle must still move: a parked vehicle may be
# simulated without noise. A short repetition only means that the camera is a little slower than the frames.
LEAST_MOTION_M = 1.0
LEAST_TURN_DEG = 3.0
LEAST_TIME_S = 0.3
LEAST_REPEATS = 3

# An image that is only similar may be the same scene again, if the pose of a parked vehicle drifts.
LEAST_MOTION_IF_SIMILAR_M = 3.0
LEAST_TURN_IF_SIMILAR_DEG = 10.0

CHECK_CAMERA = "Check the camera and its image files."
CHECK_PLAYER = "Check that images, times and poses are of the same frames."


@dataclass
class ImageRun:
    """Consecutive frames in which a camera has the same image.

    index, frame, thumbnail: of the first frame.
    last: index of the last frame. repeats: number of frames after the first.
    is_exact: whether all images are exact copies.
    moved_m, turned_deg: largest distance and turn of the ego pose since the first frame.
    elapsed_s: since the first frame.
    """

    index: int
    frame: Frame
    thumbnail: Thumbnail
    last: int
    repeats: int = 0
    is_exact: bool = True
    moved_m: float = 0.0
    turned_deg: float = 0.0
    elapsed_s: float = 0.0

    @property
    def is_frozen(self) -> bool:
        """Whether the image stayed the same although the vehicle moved."""
        if not self.is_exact:
            return self.moved_m >= LEAST_MOTION_IF_SIMILAR_M or self.turned_deg >= LEAST_TURN_IF_SIMILAR_DEG
        has_moved = self.moved_m >= LEAST_MOTION_M or self.turned_deg >= LEAST_TURN_DEG
        return has_moved and (self.elapsed_s >= LEAST_TIME_S or self.repeats >= LEAST_REPEATS)

    def add(self, index: int, frame: Frame, thumbnail: Thumbnail) -> None:
        """Add the next frame with the same image."""
        poses = self.frame.global_T_ego, frame.global_T_ego
        self.last, self.repeats = index, self.repeats + 1
        self.is_exact = self.is_exact and thumbnail.digest == self.thumbnail.digest
        self.moved_m = max(self.moved_m, distance_between_m(*poses))
        self.turned_deg = max(self.turned_deg, float(np.degrees(turn_between_rad(*poses))))
        self.elapsed_s = float(frame.timestamp_s) - float(self.frame.timestamp_s)


class FrozenImages:
    """Finds frozen cameras in frames that come in order. Keeps one thumbnail per camera."""

    def __init__(self) -> None:
        self._runs: dict[str, ImageRun] = {}
        self._first: dict[str, ImageRun] = {}  # the first frozen run of each camera
        self._num_frozen: dict[str, int] = {}  # frames, by camera, in earlier frozen runs
        self._cameras: set[str] = set()  # that have had an image with content

    def add(self, index: int, frame: Frame, thumbnails: Mapping[str, Thumbnail]) -> None:
        """Add the next frame. thumbnails: of its images, by camera; without lost cameras."""
        for name, thumbnail in thumbnails.items():
            if not thumbnail.is_flat:
                self._cameras.add(name)
            run = self._runs.get(name)
            if run and run.frame.scene == frame.scene and is_same_image(run.thumbnail, thumbnail):
                run.add(index, frame, thumbnail)
                if run.is_frozen:
                    self._first.setdefault(name, run)
                continue
            if run and run.is_frozen:
                self._num_frozen[name] = self._num_frozen.get(name, 0) + run.repeats
            self._runs[name] = ImageRun(index, frame, thumbnail, index)

    def camera_findings(self) -> list[tuple[str, Finding]]:
        """Camera and finding for each frozen camera, unless all cameras are frozen."""
        return [] if self._are_all_frozen() else [(name, self._camera_finding(name)) for name in self._first]

    def drive_findings(self) -> list[Finding]:
        """A finding if all of several cameras are frozen."""
        if not self._are_all_frozen():
            return []
        run = min(self._first.values(), key=lambda run: run.index)
        cause = "Likely cause: the same images were given again with new poses, or the poses are of another recording."
        if not all(run.is_exact for run in self._first.values()):
            cause = f"{cause[:-1]}, or the vehicle is parked and its pose drifts."
        return [
            Finding(
                "images",
                Verdict.SUSPECT,
                "images that change while the vehicle moves",
                f"the same images of all {len(self._first)} cameras {_extent(run)}",
                cause,
                CHECK_PLAYER,
                run.index + 1,
                max(map(self._num_frames, self._first)),
            )
        ]

    def _are_all_frozen(self) -> bool:
        return len(self._first) > 1 and len(self._first) == len(self._cameras)

    def _camera_finding(self, name: str) -> Finding:
        run = self._first[name]
        return Finding(
            "frozen image",
            Verdict.SUSPECT,
            "images that change while the vehicle moves",
            f"the same image {_extent(run)}",
            "Likely cause: the camera is frozen or slower than the frames, or an earlier image was given again.",
            CHECK_CAMERA,
            run.index + 1,
            self._num_frames(name),
        )

    def _num_frames(self, name: str) -> int:
        """Number of frames in which a camera repeated its image while the vehicle moved."""
        run = self._runs[name]
        return self._num_frozen.get(name, 0) + (run.repeats if run.is_frozen else 0)


def _extent(run: ImageRun) -> str:
    moved = f"moved {run.moved_m:.1f} m" if run.moved_m >= LEAST_MOTION_M else f"turned {run.turned_deg:.0f} degrees"
    return f"in frames {run.index} to {run.last}, while the vehicle {moved}"
