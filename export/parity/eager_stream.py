"""The model in eager mode as a stream: frame in, detections out, like the runtime's own."""

from collections.abc import Mapping
from dataclasses import replace

from torch import Tensor

from ...model import DuoSpaceNet
from ...runtime.bundle.manifest import Manifest
from ...runtime.detections import Detections, HistoryReport, select, sigmoid
from ...runtime.frame import Frame
from ...runtime.lost_cameras import skip_reason
from ...runtime.validation import check_frame
from .reference import EagerReference, Run
from .stress_sequence import windows


class EagerStream:
    """Steps the reference through a drive, with the window that the manifest asks for. One vehicle's."""

    def __init__(self, model: DuoSpaceNet, manifest: Manifest) -> None:
        self._manifest = manifest
        self._reference = EagerReference(model.eval(), manifest.preprocessing)
        self._frames: list[Frame] = []  # of the past only poses and times are read: they are kept without pictures
        self._start = 0

    def reset(self) -> None:
        """The next frame continues none of those before."""
        self._start = len(self._frames)

    def step(self, frame: Frame) -> Detections:
        """Detect the objects of `frame`, and draw its maps. A frame without any picture is skipped.

        Raises InputError for a frame that cannot be right.
        """
        check_frame(frame, self._manifest.num_cameras)
        if skipped := skip_reason(frame, "blank"):
            return Detections.of_skipped_frame(frame, skipped)
        self._frames.append(frame)
        window = self._window()
        runs = self._reference.step(self._frames, window)
        self._frames[-1] = replace(frame, images={}, ground_truth=None)
        return self._answer(frame, runs, len(window))

    def _window(self) -> list[int]:
        """Indices of the frames that the newest one is looked at with, newest first."""
        limits = self._manifest.window
        oldest = max(self._start, len(self._frames) - limits.num_frames)
        return [oldest + index for index in windows(self._frames[oldest:], limits)[-1]]

    def _answer(self, frame: Frame, runs: Mapping[str, Run], num_frames: int) -> Detections:
        outputs: dict[str, Tensor] = runs["decoder"].outputs
        boxes = outputs["boxes"].numpy()
        queries, labels, scores, dropped = select(outputs["class_logits"].numpy(), boxes)
        masks = runs["segmenter"].outputs if "segmenter" in runs else {}
        return Detections(
            boxes=boxes[queries],
            scores=scores,
            classes=tuple(self._manifest.classes[label] for label in labels),
            queries=queries,
            history=HistoryReport(num_frames),
            maps={name: sigmoid(mask.numpy()[0, 0]) for name, mask in masks.items()},
            dropped_queries=dropped,
            scene=frame.scene,
            token=frame.token,
            timestamp_s=float(frame.timestamp_s),
        )
