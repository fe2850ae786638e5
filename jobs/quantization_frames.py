"""The frames of a quantization: some for the calibration, and others for the comparison with the float32 bundle."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from ..data.source import Source
from ..runtime.errors import UsageError


@dataclass(frozen=True)
class Clip:
    """Consecutive frames of a source, `start` to `stop - 1`."""

    source: Source
    start: int
    stop: int

    def __len__(self) -> int:
        return self.stop - self.start


def split_frames(
    sources: Sequence[Source], eval_sources: Sequence[Source], limit: int | None = None
) -> tuple[list[Clip], list[Clip]]:
    """The clips for the calibration, and the clips for the comparison. No frame is in both.

    With `eval_sources`, they are compared and `sources` calibrate. Otherwise the second half of `sources` is compared.
    A single source is divided into its first and its second half.

    limit: only use the first frames of each source.
    Raises UsageError if a source is in both lists, or if there are too few frames to divide.
    """
    if eval_sources:
        _check_different(sources, eval_sources)
        return _whole(sources, limit), _whole(eval_sources, limit)
    if len(sources) > 1:
        _check_different(sources[: len(sources) // 2], sources[len(sources) // 2 :])
        return _whole(sources[: len(sources) // 2], limit), _whole(sources[len(sources) // 2 :], limit)
    (whole,) = _whole(sources, limit)
    middle = whole.stop // 2
    if middle == 0:
        raise UsageError(
            "--source: expected at least two frames, one for the calibration and one to compare; got one. Add "
            "--eval-source with other frames."
        )
    return [replace(whole, stop=middle)], [replace(whole, start=middle)]


def shortened(clips: Sequence[Clip], num_frames: int) -> list[Clip]:
    """The first frames of each clip, about `num_frames` in all."""
    per_clip = -(-num_frames // len(clips))
    return [replace(clip, stop=min(clip.stop, clip.start + per_clip)) for clip in clips]


def _whole(sources: Sequence[Source], limit: int | None) -> list[Clip]:
    return [Clip(source, 0, len(source) if limit is None else min(len(source), limit)) for source in sources]


def _check_different(sources: Sequence[Source], others: Sequence[Source]) -> None:
    if common := {source.identity for source in sources} & {source.identity for source in others}:
        raise UsageError(
            f"--eval-source: expected other sources than those of the calibration; got {sorted(common)[0]} twice. "
            "The metrics of calibration frames say little about other frames."
        )
