"""The frames of a benchmark: decoded once, then repeated so that the temporal window stays full."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from ...data.source import Source
from ...runtime.bundle.manifest import Manifest
from ...runtime.errors import InputError
from ...runtime.frame import Frame
from ...runtime.history import find_reset
from ..input_warnings import InputWarnings
from ..notify import Notify, ignore
from ..source_check import check_source
from ..sources import open_source

MAX_DISTINCT = 6  # decoded frames; six cameras of 1600 × 900 px have 26 MB
MAX_SEARCHED = 200  # frames that are searched for frames without lost cameras
SYNTHETIC_SEED = 7
SYNTHETIC_SIZE_PX = (1600, 900)  # nuScenes' images, so that preprocessing has as much work as on a real rig
SCENE = "bench"


class FrameCycle(Iterator[Frame]):
    """Repeats frames without an end: forwards, then backwards, then forwards again.

    Neighbours are always neighbours of the source too, so no ego jump appears. Time advances by the time between the
    two, so no gap appears and the stream never resets.
    """

    def __init__(self, frames: Sequence[Frame], time_delta_s: float) -> None:
        """frames: at least one, in time order. time_delta_s: time between repetitions of a single frame."""
        self._frames = list(frames)
        self._order = [*range(len(frames)), *range(len(frames) - 2, 0, -1)]
        self._time_delta_s = time_delta_s
        self._count = 0
        self._time_s = frames[0].timestamp_s

    def __next__(self) -> Frame:
        frame = self._frames[self._order[self._count % len(self._order)]]
        result = replace(frame, timestamp_s=self._time_s, scene=SCENE, ground_truth=None)
        self._count += 1
        following = self._frames[self._order[self._count % len(self._order)]]
        self._time_s += abs(following.timestamp_s - frame.timestamp_s) or self._time_delta_s
        return result


def decode_frames(
    source: str | Path | None, manifest: Manifest, check: bool = True, notify: Notify = ignore
) -> tuple[str, list[Frame]]:
    """Decode the frames of a source that a benchmark repeats. Returns the source's name and the frames.

    The frames are the first ones without lost cameras that no reset separates, at most `MAX_DISTINCT`.

    source: None for synthetic frames of the size of nuScenes' images.
    check: refuse calibrations that `check-rig` calls broken.
    Raises InputError for a source that is not valid or has no frame with an image.
    """
    if source is None:
        from ...synthetic.drive import SyntheticDrive  # only here: other sources need no renderer

        drive = SyntheticDrive(SYNTHETIC_SEED, MAX_DISTINCT, SYNTHETIC_SIZE_PX)
        width_px, height_px = SYNTHETIC_SIZE_PX
        return f"{drive.identity}, {width_px}×{height_px} px", list(drive)
    opened = open_source(source)
    check_source(opened, manifest, InputWarnings(notify), refuse_broken=check, num_frames=MAX_SEARCHED)
    return str(source), [opened.frame(index) for index in _choose_frames(opened, manifest, str(source))]


def _choose_frames(source: Source, manifest: Manifest, name: str) -> list[int]:
    """The indices of consecutive frames, without those that have lost cameras."""
    searched = range(len(source))[:MAX_SEARCHED]
    lost = {index: len(source.check_image_files(index)) for index in searched}
    headers = {index: source.frame_without_images(index) for index in searched}
    complete = [index for index in searched if lost[index] == 0]
    usable = complete or [index for index in searched if lost[index] < len(headers[index].cameras)]
    if not usable:
        raise InputError(
            f"{name}: expected a frame with an image; got none in the first {len(searched)} frames. "
            "Choose another --source, or leave it out."
        )
    chosen = usable[:1]
    for index in usable[1:MAX_DISTINCT]:
        if find_reset(headers[chosen[-1]], headers[index], manifest.window):
            break
        chosen.append(index)
    return chosen
