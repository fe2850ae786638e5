"""Compare the ranking of blocks by `quantize` with a ranking by the project's own evaluator.

    python -m benchmarks.quantization_sensitivity BUNDLE --frames 12

The losses of single blocks are below the noise of mAP on a few hundred frames. So the confident detections of the
float32 bundle take the place of the ground truth: its own mAP is then close to 1, and every box that moves counts.
"""

import argparse
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from duospacenet.evaluation import Sample, evaluate
from duospacenet.export.quantization.candidate import blocks_in
from duospacenet.jobs.quantization_calibration import calibrate, measure_sensitivities
from duospacenet.jobs.quantization_frames import Clip, shortened
from duospacenet.jobs.quantization_judge import judge
from duospacenet.jobs.sources import open_source
from duospacenet.runtime import Detections, Pipeline
from duospacenet.runtime.cpu import describe_cpu
from duospacenet.runtime.frame import GroundTruth
from duospacenet.runtime.progress import no_progress

MIN_SCORE = 0.3  # of the float32 detections that count as true


def main() -> None:
    """Print one line per block: its rank by both measures, and their rank correlation."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("bundle", type=Path)
    parser.add_argument("--frames", type=int, default=12)
    arguments = parser.parse_args()
    pipeline = Pipeline.load(arguments.bundle)
    source, judged = (open_source(f"synthetic:{seed}:{arguments.frames}") for seed in (300, 301))
    clips = [Clip(source, 0, arguments.frames)]
    with tempfile.TemporaryDirectory() as folder:
        candidates = calibrate(arguments.bundle, pipeline, clips, Path(folder))
    blocks = [block for block in blocks_in(arguments.bundle, pipeline.manifest) if block.graph != "segmenter"]
    rows = measure_sensitivities(pipeline, candidates, blocks, shortened(clips, 6))
    judging = [Clip(judged, 0, arguments.frames)]
    float32 = judge(pipeline, judging, False, no_progress, "").detections
    own = own_score(float32, float32)
    losses = []
    for row in rows:
        graphs = candidates.engine_pipeline(candidates.quantize([row.block]))
        losses.append(own - own_score(float32, judge(graphs, judging, False, no_progress, "").detections))
        print(f"{row.block.name:<42} error {row.error:.4f}   loss of mAP against float32 {losses[-1]:.4f}", flush=True)
    print(f"rank correlation {rank_correlation([row.error for row in rows], losses):.2f}; {describe_cpu()}")


def own_score(truth: Sequence[Detections], detections: Sequence[Detections]) -> float:
    """mAP with the confident detections of the float32 bundle as ground truth, over the classes that it has."""
    samples = []
    for expected, got in zip(truth, detections, strict=True):
        rows = expected.scores >= MIN_SCORE
        classes = tuple(name for name, kept in zip(expected.classes, rows, strict=True) if kept)
        samples.append(Sample(got, GroundTruth(boxes=expected.boxes[rows].astype(np.float64), classes=classes)))
    reports = [report for report in evaluate(samples).classes if report.num_truth]
    return float(np.mean([report.mean_average_precision for report in reports]))


def rank_correlation(first: Sequence[float], second: Sequence[float]) -> float:
    """Spearman's rank correlation."""
    ranks = [np.argsort(np.argsort(values)) for values in (first, second)]
    return float(np.corrcoef(*ranks)[0, 1])


if __name__ == "__main__":
    main()
