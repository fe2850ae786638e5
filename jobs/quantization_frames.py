"""The frames of a quantization: some for the calibration, and others for the comparison with the float32 bundle."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from ..data.source import Source
from ..runtime.errors import UsageError


@dataclass(frozen=True)
class Clip:
    """Consecutive frames of a source, `start` to `stop - 1`. name: of the source, for messages."""

    source: Source
    start: int
    stop: int
    name: str = ""

    def __len__(self) -> int:
        return self.stop - self.start


def split_frames(clips: Sequence[Clip], eval_clips: Sequence[Clip]) -> tuple[list[Clip], list[Clip]]:
    """The clips for the calibration, and the clips for the comparison. No frame is in both.

    With `eval_clips`, they are compared and `clips` calibrate. Otherwise the second half of `clips` is compared.
    A single clip is divided into its first and its second half.

    Raises UsageError if a source is in both lists, or if there are too few frames to divide.
    """
    if eval_clips:
        calibration, judging = list(clips), list(eval_clips)
    elif len(clips) > 1:
        calibration, judging = list(clips[: len(clips) // 2]), list(clips[len(clips) // 2 :])
    else:
        return _halves(clips[0])
    if common := {clip.source.identity for clip in calibration} & {clip.source.identity for clip in judging}:
        raise UsageError(
            f"--eval-source: expected other sources than those of the calibration; got {sorted(common)[0]} twice. "
            "The metrics of calibration frames say little about other frames."
        )
    return calibration, judging


def shortened(clips: Sequence[Clip], num_frames: int) -> list[Clip]:
    """The first frames of each clip, about `num_frames` in all."""
    per_clip = -(-num_frames // len(clips))
    return [replace(clip, stop=min(clip.stop, clip.start + per_clip)) for clip in clips]


def _halves(clip: Clip) -> tuple[list[Clip], list[Clip]]:
    middle = clip.stop // 2
    if middle == 0:
        raise UsageError(
            "--source: expected at least two frames, one for the calibration and one to compare; got one. Add "
            "--eval-source with other frames."
        )
    return [replace(clip, stop=middle)], [replace(clip, start=middle)]
