"""Training clips of a source: each epoch has every frame once, or is balanced between classes."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from ...data.box_selection import known_ground_truth
from ...data.source import Source
from ...runtime.bundle.temporal_window import TemporalWindow
from ...runtime.frame import Frame, GroundTruth
from ...runtime.history import find_reset
from .epoch_order import EpochOrder, group_by_class
from .past_frames import PastFrames


@dataclass(frozen=True)
class FrameClasses:
    """The classes of the boxes in each frame of a source, for class-balanced sampling.

    classes: the classes of the model.
    of_frames: the classes in each frame.
    """

    classes: tuple[str, ...]
    of_frames: tuple[frozenset[str], ...]

    def group(self, clips: Sequence[Sequence[int]]) -> tuple[tuple[int, ...], ...]:
        """The clips, given by the indices of their frames, that contain each class: `EpochOrder.class_items`."""
        of_clips = [frozenset().union(*(self.of_frames[index] for index in clip)) for clip in clips]
        return group_by_class(of_clips, self.classes)


@dataclass(frozen=True)
class SourceClips:
    """Clips of consecutive frames. Every frame is trained, one after the other.

    The source is split where the runtime would reset the history, and after every `num_frames` frames. A clip in which
    no frame has ground truth to train on is left out. Each epoch has every clip once, in another random order.

    source: a source with ground truth.
    seed: the seed of the random order.
    num_frames: frames per clip; a clip before a reset may be shorter.
    limits: the limits beyond which the runtime resets the history.
    trainable: the indices of the frames with ground truth to train on; None = all.
    balance: sample clips with rare classes more often, see `EpochOrder`.
    """

    source: Source
    seed: int
    num_frames: int
    limits: TemporalWindow
    trainable: frozenset[int] | None = None
    balance: FrameClasses | None = None

    @property
    def identity(self) -> str:
        return describe(self.source, self.limits)

    @cached_property
    def samples_per_epoch(self) -> int:
        return sum(map(self.num_steps, range(self._order.items_per_epoch)))

    def frames(self, number: int) -> list[Frame]:
        return [self.source.frame(index) for index in self._clip(number)]

    def num_steps(self, number: int) -> int:
        return len(self._clip(number))

    def ground_truth(self) -> Iterator[GroundTruth]:
        """The ground truth of all frames of the source whose boxes are known."""
        return known_ground_truth(self.source, range(len(self.source)))

    def _clip(self, number: int) -> range:
        """The indices of the frames of clip `number` in the source."""
        return self._clips[self._order.item(number)]

    @cached_property
    def _clips(self) -> list[range]:
        """The frame indices of each clip, in the order of the source."""
        clips = [
            range(first, min(first + self.num_frames, scene.stop))
            for scene in split_at_resets(self.source, self.limits)
            for first in range(scene.start, scene.stop, self.num_frames)
        ]
        return clips if self.trainable is None else [clip for clip in clips if not self.trainable.isdisjoint(clip)]

    @cached_property
    def _order(self) -> EpochOrder:
        groups = None if self.balance is None else self.balance.group(self._clips)
        return EpochOrder(self.seed, len(self._clips), groups)


@dataclass(frozen=True)
class SourceWindows:
    """Samples of one frame with its past frames. Only the newest frame is trained.

    The window of a sample never crosses a reset of the runtime's history. Frames after a reset have fewer past frames.
    Each epoch has every frame with ground truth to train on once, in random order. The strides differ between epochs.

    source: a source with ground truth.
    past: which past frames a sample has. With a stride above 1, two neighbours of a window may be more than
        `limits.largest_time_delta_s` apart if the source lacks frames. The window then starts after this gap.
    limits: the limits beyond which the runtime resets the history.
    trainable: the indices of the frames with ground truth to train on; None = all.
    balance: sample frames with rare classes more often, see `EpochOrder`.
    """

    source: Source
    past: PastFrames
    limits: TemporalWindow
    trainable: frozenset[int] | None = None
    balance: FrameClasses | None = None

    @property
    def identity(self) -> str:
        return describe(self.source, self.limits)

    @property
    def samples_per_epoch(self) -> int:
        return self._order.items_per_epoch

    def frames(self, number: int) -> list[Frame]:
        newest = self._newest[self._order.item(number)]
        window = self.past.window(newest, int(self._first_of_scene[newest]), number)
        return [self.source.frame(index) for index in self._after_last_gap(window)]

    def num_steps(self, number: int) -> int:
        return 1

    def ground_truth(self) -> Iterator[GroundTruth]:
        """The ground truth of all frames of the source whose boxes are known."""
        return known_ground_truth(self.source, range(len(self.source)))

    def _after_last_gap(self, window: list[int]) -> list[int]:
        """The newest frames of a window that are at most the largest time delta apart."""
        times_s = [self.source.frame_without_images(index).timestamp_s for index in window]
        gaps = [
            position
            for position, (older_s, newer_s) in enumerate(pairwise(times_s), start=1)
            if newer_s - older_s > self.limits.largest_time_delta_s
        ]
        return window[gaps[-1] if gaps else 0 :]

    @cached_property
    def _newest(self) -> list[int]:
        """The indices of the frames that are trained."""
        return list(range(len(self.source))) if self.trainable is None else sorted(self.trainable)

    @cached_property
    def _first_of_scene(self) -> np.ndarray:
        """For each frame, the index of the first frame after the last reset."""
        scenes = split_at_resets(self.source, self.limits)
        return np.concatenate([np.full(len(scene), scene.start) for scene in scenes])

    @cached_property
    def _order(self) -> EpochOrder:
        groups = None if self.balance is None else self.balance.group([(index,) for index in self._newest])
        return EpochOrder(self.past.seed, len(self._newest), groups)


def split_at_resets(source: Source, limits: TemporalWindow) -> list[range]:
    """Split a source where the runtime would reset the history. Returns the indices of the frames of each part."""
    frames = map(source.frame_without_images, range(len(source)))
    is_reset = (find_reset(last, frame, limits) is not None for last, frame in pairwise(frames))
    starts = [0, *(index for index, reset in enumerate(is_reset, 1) if reset)]
    return [range(start, end) for start, end in pairwise([*starts, len(source)])]


def describe(source: Source, limits: TemporalWindow) -> str:
    """The identity of the clips of a source."""
    text = f"{limits.largest_time_delta_s:g} s, {limits.largest_speed_m_s:g} m/s"
    turn = f"{np.degrees(limits.largest_turn_rad_s):g} degrees/s"
    return f"{source.identity}, split beyond {text} or {turn}"
