"""The model in eager mode as a stream of frames, with the interface of the runtime's stream."""

from collections.abc import Mapping
from dataclasses import replace

from torch import Tensor

from ...model import DuoSpaceNet, DuoSpaceNetConfig
from ...runtime.detections import Detections, HistoryReport, select_detections, sigmoid
from ...runtime.frame import Frame
from ...runtime.lost_cameras import skip_reason
from ...runtime.validation import check_frame
from ...weights.input_contract import temporal_window
from .expected_windows import expected_windows
from .reference import EagerReference, GraphRun


class EagerStream:
    """Runs the reference on the frames of one vehicle, with the temporal window of the model's configuration.

    The model may be on a GPU.
    """

    def __init__(self, model: DuoSpaceNet) -> None:
        self._config = model.config
        self._limits = temporal_window(model.config)
        self._reference = EagerReference(model)
        # Past frames are kept without their images, because only their poses and times are needed.
        self._frames: list[Frame] = []
        self._start = 0  # index of the first frame after the last reset

    def reset(self) -> None:
        """Drop the history. The next frame starts a new window."""
        self._start = len(self._frames)

    def step(self, frame: Frame) -> Detections:
        """Detect the objects of `frame` and segment its map. A frame without any image is skipped.

        Raises InputError if the frame is invalid.
        """
        check_frame(frame, self._config.num_cameras)
        if reason := skip_reason(frame, "blank"):
            return Detections.of_skipped_frame(frame, reason)
        self._frames.append(frame)
        window = self._window()
        runs = self._reference.step(self._frames, window)
        self._frames[-1] = replace(frame, images={}, ground_truth=None)
        return detections_of(self._config, frame, runs, HistoryReport(len(window)))

    def _window(self) -> list[int]:
        """Indices of the frames in the newest frame's window, newest first."""
        oldest = max(self._start, len(self._frames) - self._limits.num_frames)
        return [oldest + index for index in expected_windows(self._frames[oldest:], self._limits)[-1]]


def detections_of(
    config: DuoSpaceNetConfig, frame: Frame, runs: Mapping[str, GraphRun], history: HistoryReport
) -> Detections:
    """The detections and map probabilities of a frame, from the outputs of the graphs in eager mode."""
    outputs: dict[str, Tensor] = runs["decoder"].outputs
    boxes = outputs["boxes"].cpu().numpy()
    queries, labels, scores, dropped = select_detections(outputs["class_logits"].cpu().numpy(), boxes)
    masks = runs["segmenter"].outputs if "segmenter" in runs else {}
    return Detections(
        boxes=boxes[queries],
        scores=scores,
        classes=tuple(config.classes[label] for label in labels),
        queries=queries,
        history=history,
        maps={name: sigmoid(mask.cpu().numpy()[0, 0]) for name, mask in masks.items()},
        dropped_queries=dropped,
        scene=frame.scene,
        token=frame.token,
        timestamp_s=float(frame.timestamp_s),
    )
