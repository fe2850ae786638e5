"""The time of a nuScenes evaluation, in seconds and relative to fixed numpy work of the same run.

    OMP_NUM_THREADS=1 python -m benchmarks.evaluation_speed [SAMPLES]

The default, 4,000 samples of about 60 detections and 30 true boxes, is two thirds of the nuScenes validation set.
The fixed work is two matrix products and a sort. Both are measured in CPU time; set OMP_NUM_THREADS=1.
"""

import sys
import time

import numpy as np

from benchmarks.cpu import describe_cpu
from duospacenet.evaluation import evaluate
from tests.helpers.evaluation_samples import random_sample

NUM_SAMPLES = 4000
NUM_DISTINCT = 40  # samples are generated once and repeated
NUM_REFERENCE_RUNS = 5


def main() -> None:
    num_samples = int(sys.argv[1]) if len(sys.argv) > 1 else NUM_SAMPLES
    rng = np.random.default_rng(0)
    distinct = [random_sample(rng, num_true=30, num_false=30) for _ in range(NUM_DISTINCT)]
    reference_s = min(multiply_and_sort_time_s() for _ in range(NUM_REFERENCE_RUNS))
    start_s = time.thread_time()
    evaluate(distinct[number % NUM_DISTINCT] for number in range(num_samples))
    evaluation_s = time.thread_time() - start_s
    per_thousand_s = 1000 * evaluation_s / num_samples
    print(f"CPU: {describe_cpu()}")
    print(f"evaluation: {evaluation_s:.2f} s for {num_samples} samples, {per_thousand_s:.3f} s per 1,000 samples")
    print(f"reference: {reference_s:.4f} s; ratio per 1,000 samples: {per_thousand_s / reference_s:.1f}")


def multiply_and_sort_time_s() -> float:
    """The CPU time of the fixed work [s]. With several OpenBLAS threads only that of this thread would count."""
    rng = np.random.default_rng(0)
    matrix, numbers = rng.normal(size=(512, 512)), rng.normal(size=500_000)
    start_s = time.thread_time()
    matrix @ matrix @ matrix
    np.exp(np.sort(numbers)).sum()
    return time.thread_time() - start_s


if __name__ == "__main__":
    main()
