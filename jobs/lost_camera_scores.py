"""Scores of a detector that loses cameras: 1 to N - 1 of its N cameras in every frame.

In every frame other cameras are lost, at random. As in RoboBEV, their images are missing and their calibration is
known. RoboBEV draws cameras with replacement, so that a camera can be drawn twice and fewer are lost. Here the cameras
of a frame are distinct, and those lost with k cameras are lost with k + 1 cameras too.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..data.source import Source
from ..evaluation import EvaluationReport
from ..runtime import Detections, Frame
from .detectors import Detector

SEED = 0


@dataclass(frozen=True)
class LostCameraScore:
    """The scores with some cameras lost in every frame.

    num_lost: number of lost cameras.
    mean_ap, nds: mAP and NDS.
    """

    num_lost: int
    mean_ap: float
    nds: float

    @classmethod
    def of(cls, num_lost: int, report: EvaluationReport) -> "LostCameraScore":
        """The scores of a report."""
        return cls(num_lost, report.mean_average_precision, report.nds)

    def to_dict(self) -> dict[str, float | int]:
        """The fields as JSON values."""
        return {"lost": self.num_lost, "mAP": self.mean_ap, "NDS": self.nds}


class CameraLoser:
    """A detector that gets each frame without the images of some cameras."""

    def __init__(self, detector: Detector, num_lost: int, seed: int = SEED) -> None:
        self._detector, self._num_lost, self._seed = detector, num_lost, seed
        self._num_frames = 0

    def reset(self) -> None:
        """Drop the history of frames."""
        self._detector.reset()

    def step(self, frame: Frame) -> Detections:
        """Detect the objects of the next frame. A frame without any image left has no detections."""
        lost = lost_cameras(frame, self._num_lost, np.random.default_rng([self._seed, self._num_frames]))
        self._num_frames += 1
        return self._detector.step(replace(frame, images={**frame.images, **dict.fromkeys(lost)}))


def lost_cameras(frame: Frame, num_lost: int, generator: np.random.Generator) -> list[str]:
    """Choose the cameras that a frame loses: `num_lost` distinct ones of those with an image, or all of them.

    With the same generator, the first ones are the same for every `num_lost`.
    """
    present = sorted(name for name, image in frame.images.items() if image is not None)
    return [present[index] for index in generator.permutation(len(present))[:num_lost]]


def score_lost_cameras(
    detector: Detector,
    complete: EvaluationReport,
    num_cameras: int,
    evaluate_detector: Callable[[Detector], EvaluationReport],
) -> tuple[LostCameraScore, ...]:
    """Evaluate a detector with 1 to N - 1 lost cameras. Each number costs one evaluation.

    complete: the report without lost cameras.
    num_cameras: N.
    """
    reports = (evaluate_detector(CameraLoser(detector, num_lost)) for num_lost in range(1, num_cameras))
    return tuple(LostCameraScore.of(num_lost, report) for num_lost, report in enumerate([complete, *reports]))


def fewest_cameras(sources: Sequence[Source], limit: int | None = None) -> int:
    """The smallest number of cameras in a frame of the sources."""
    return min(_numbers_of_cameras(sources, limit), default=0)


def _numbers_of_cameras(sources: Sequence[Source], limit: int | None) -> Iterator[int]:
    for source in sources:
        for index in range(len(source))[:limit]:
            yield len(source.frame_without_images(index).cameras)
