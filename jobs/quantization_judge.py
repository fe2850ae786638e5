"""Runs of a bundle over clips, for the comparison of an int8 bundle with its float32 bundle."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..evaluation import EvaluationReport, Sample, evaluate
from ..evaluation.agreement import Agreement
from ..runtime import Detections, Frame, Pipeline
from ..runtime.bundle.quantization_record import AgreementRecord, MetricsRecord
from ..runtime.errors import InputError
from ..runtime.progress import Progress
from .quantization_frames import Clip


@dataclass(frozen=True)
class Judgement:
    """What a bundle detected. detections: of every frame, without maps. metrics: None without ground truth."""

    detections: list[Detections]
    metrics: MetricsRecord | None

    def agreement(self, reference: "Judgement") -> AgreementRecord:
        """The agreement with the detections of another bundle on the same frames."""
        agreement = Agreement()
        for expected, detections in zip(reference.detections, self.detections, strict=True):
            agreement.add(expected, detections)
        return AgreementRecord(
            boxes=agreement.boxes,
            matched=agreement.matched_fraction,
            score=agreement.mean_score_difference,
            position_m=agreement.mean_distance_m,
        )


def judge(pipeline: Pipeline, clips: Sequence[Clip], with_metrics: bool, progress: Progress, label: str) -> Judgement:
    """Run a bundle over clips, with an empty history at the start of each.

    with_metrics: evaluate the detections and the maps. Raises InputError if no true box counts.
    label: for the progress.
    """
    detections: list[Detections] = []

    def samples() -> Iterator[Sample]:
        for frame, detected in run_clips(pipeline, clips, progress, label):
            detections.append(replace(detected, maps={}))
            if with_metrics and frame.ground_truth is not None and frame.ground_truth.has_boxes:
                yield Sample.of_detections(detected, frame.ground_truth, frame.global_T_ego)

    report = evaluate(samples())
    if with_metrics and not report.ground_truth.num_used:
        raise InputError(
            "the frames for the comparison: expected at least one true box that counts; got none. Name other frames "
            "with --eval-source, or add --no-metrics."
        )
    return Judgement(detections, _metrics(report) if with_metrics else None)


def run_clips(
    pipeline: Pipeline, clips: Sequence[Clip], progress: Progress, label: str
) -> Iterator[tuple[Frame, Detections]]:
    """Run a bundle over clips, and yield each frame with its detections and maps."""
    frames = [(number, index) for number, clip in enumerate(clips) for index in range(clip.start, clip.stop)]
    stream = pipeline.stream(maps="segmenter" in pipeline.sessions)
    for number, index in progress(frames, label):
        if index == clips[number].start:
            stream.reset()
        frame = clips[number].source.frame(index)
        yield frame, stream.step(frame)


def _metrics(report: EvaluationReport) -> MetricsRecord:
    map_iou = {name: iou for name, iou in report.map_iou.items() if np.isfinite(iou)}
    return MetricsRecord(mAP=report.mean_average_precision, NDS=report.nds, map_iou=map_iou)
