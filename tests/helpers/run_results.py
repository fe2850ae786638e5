"""Results of runs that are written without a bundle: boxes that a test chooses, over the frames of a source."""

from pathlib import Path

import numpy as np

from duospacenet.data.results import ResultsFile, frame_result
from duospacenet.runtime import Detections, Frame
from duospacenet.runtime.detections import HistoryReport


def detections_at(boxes, classes, scores, frame: Frame, **fields) -> Detections:
    """The detections of a frame. boxes: (D, 9)."""
    boxes = np.asarray(boxes, np.float32).reshape(-1, 9)
    return Detections(
        boxes,
        np.asarray(scores, np.float32),
        tuple(classes),
        np.arange(len(boxes)),
        HistoryReport(1),
        scene=frame.scene,
        token=frame.token,
        timestamp_s=frame.timestamp_s,
        **fields,
    )


def write_results(folder: Path, frames, detect) -> Path:
    """Write `results.jsonl` with the detections `detect(frame)` of each frame. Returns the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    with ResultsFile(folder / "results.jsonl") as file:
        for frame in frames:
            file.write(frame_result(frame, detect(frame), {}))
    return folder


def detect_truth(frame: Frame) -> Detections:
    """The true boxes as detections, with a score of 0.9."""
    truth = frame.ground_truth
    return detections_at(np.nan_to_num(truth.boxes), truth.classes, [0.9] * len(truth.classes), frame)


def detect_nothing(frame: Frame) -> Detections:
    """No detections."""
    return detections_at([], (), [], frame)
