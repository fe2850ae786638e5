"""A fixed numpy computation and the CPU's instruction sets, which make times of different machines comparable."""

import time
from pathlib import Path

import numpy as np

REPEATS = 5
INSTRUCTION_SETS = ("sse4_2", "avx", "f16c", "fma", "avx2", "avx512f", "avx512_vnni", "avx_vnni", "amx_int8", "asimd")


def reference_time_s() -> float:
    """The best time of a few runs of a fixed computation: matrix products, sorting and an elementwise function [s]."""
    rng = np.random.default_rng(0)
    matrix, numbers = rng.normal(size=(512, 512)), rng.normal(size=500_000)
    times_s = []
    for _ in range(REPEATS):
        start_s = time.perf_counter()
        matrix @ matrix @ matrix
        np.exp(np.sort(numbers)).sum()
        times_s.append(time.perf_counter() - start_s)
    return min(times_s)


def cpu_flags() -> list[str]:
    """The instruction sets of this CPU that matter for speed; empty if the system does not list them."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:  # not Linux
        return []
    flags = {flag for line in lines if line.startswith(("flags", "Features")) for flag in line.split(":", 1)[1].split()}
    return [name for name in INSTRUCTION_SETS if name in flags]
