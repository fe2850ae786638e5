"""The time of a nuScenes evaluation, in seconds and relative to fixed numpy work of the same run.

    python -m benchmarks.evaluation_speed [SAMPLES]

The default, 4,000 samples of about 60 detections and 30 true boxes, is two thirds of the nuScenes validation set.
The fixed work is a sort and an exponential, which numpy computes in one thread. Both are measured in CPU time.
"""

import sys
import time

import numpy as np

from duospacenet.evaluation import evaluate
from duospacenet.runtime.cpu import describe_cpu
from tests.helpers.evaluation_samples import random_sample

NUM_SAMPLES = 4000
NUM_DISTINCT = 40  # samples are generated once and repeated
NUM_REFERENCE_RUNS = 5


def main() -> None:
    num_samples = int(sys.argv[1]) if len(sys.argv) > 1 else NUM_SAMPLES
    rng = np.random.default_rng(0)
    distinct = [random_sample(rng, num_true=30, num_false=30) for _ in range(NUM_DISTINCT)]
    reference_s = min(sort_time_s() for _ in range(NUM_REFERENCE_RUNS))
    start_s = time.thread_time()
    evaluate(distinct[number % NUM_DISTINCT] for number in range(num_samples))
    evaluation_s = time.thread_time() - start_s
    per_thousand_s = 1000 * evaluation_s / num_samples
    print(f"CPU: {describe_cpu()}")
    print(f"evaluation: {evaluation_s:.2f} s for {num_samples} samples, {per_thousand_s:.3f} s per 1,000 samples")
    print(f"reference: {reference_s:.4f} s; ratio per 1,000 samples: {per_thousand_s / reference_s:.1f}")


def sort_time_s() -> float:
    """The CPU time of the fixed work [s]."""
    numbers = np.random.default_rng(0).normal(size=1_000_000)
    start_s = time.thread_time()
    np.exp(np.sort(numbers)).sum()
    return time.thread_time() - start_s


if __name__ == "__main__":
    main()
