"""The number of CPU cores that this process may use, limited by its CPU affinity and its control groups' quotas."""

import math
import os
from collections.abc import Iterator
from pathlib import Path

from .errors import UsageError

MAX_THREADS = 1024  # onnxruntime creates every thread that it is asked for: 100,000 take more than 16 GB


def available_cores(root: Path = Path("/")) -> int:
    """Return the number of usable cores, at least 1. `root` is the folder that contains /proc and /sys."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    quotas = [math.ceil(quota) for quota in _quotas(root)]
    return max(1, min([cores, *quotas]))


def check_thread_count(threads: int) -> None:
    """Raise UsageError for a number of threads outside 1 to MAX_THREADS."""
    if not 1 <= threads <= MAX_THREADS:
        raise UsageError(f"threads: expected 1 to {MAX_THREADS}; got {threads}.")


def _quotas(root: Path) -> Iterator[float]:
    """Yield the quotas [cores] of the process's control groups and of all their parents, for versions 1 and 2."""
    try:
        lines = (root / "proc/self/cgroup").read_text().splitlines()
    except OSError:
        lines = ["0::/", ":cpu:/"]
    for line in lines:
        _, controllers, group = line.split(":", 2)
        if not controllers:  # version 2 has one hierarchy for all controllers
            hierarchy = root / "sys/fs/cgroup"
        elif "cpu" in controllers.split(","):
            hierarchy = root / "sys/fs/cgroup" / controllers
        else:
            continue
        group_folder = hierarchy / group.lstrip("/")
        for folder in (group_folder, *group_folder.parents):
            yield from _quota(folder)
            if folder == hierarchy:
                break


def _quota(folder: Path) -> Iterator[float]:
    """Yield the quota of one group [cores], or nothing: "max" (version 2) and -1 (version 1) mean no limit."""
    for names in (("cpu.max",), ("cpu.cfs_quota_us", "cpu.cfs_period_us")):
        try:
            quota_us, period_us = " ".join((folder / name).read_text() for name in names).split()
            if float(quota_us) > 0:
                yield float(quota_us) / float(period_us)
        except (OSError, ValueError):
            continue
