"""The time of a nuScenes evaluation, in seconds and relative to a fixed computation of the same run.

    python -m benchmarks.evaluation_speed [SAMPLES]

The default, 4,000 samples of 60 detections and 30 true boxes, is two thirds of the nuScenes validation set.
"""

import sys
import time

import numpy as np

from benchmarks.reference_work import cpu_flags, reference_time_s
from duospacenet.evaluation import evaluate
from tests.helpers.evaluation_samples import random_sample

NUM_SAMPLES = 4000
NUM_DISTINCT = 40  # samples are generated once and repeated


def main() -> None:
    num_samples = int(sys.argv[1]) if len(sys.argv) > 1 else NUM_SAMPLES
    rng = np.random.default_rng(0)
    distinct = [random_sample(rng, num_true=30, num_false=30) for _ in range(NUM_DISTINCT)]
    reference_s = reference_time_s()
    start_s = time.perf_counter()
    report = evaluate(distinct[number % NUM_DISTINCT] for number in range(num_samples))
    elapsed_s = time.perf_counter() - start_s
    print(f"CPU flags: {' '.join(cpu_flags()) or 'unknown'}")
    per_thousand_s = 1000 * elapsed_s / num_samples
    print(f"evaluate: {report.num_samples} samples in {elapsed_s:.2f} s, {per_thousand_s:.3f} s per 1,000 samples")
    print(f"reference: {reference_s:.4f} s; ratio per 1,000 samples: {per_thousand_s / reference_s:.1f}")


if __name__ == "__main__":
    main()
