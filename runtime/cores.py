"""How many cores a process may use: by its affinity, and by the quota of its control groups."""

import math
import os
from collections.abc import Iterator
from pathlib import Path


def available_cores(root: Path = Path("/")) -> int:
    """At least 1. `root` is where /proc and /sys are."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    quotas = [math.ceil(quota) for quota in _quotas(root)]
    return max(1, min([cores, *quotas]))


def _quotas(root: Path) -> Iterator[float]:
    """The quotas, in cores, of the process' control groups and of those that they lie in; versions 2 and 1."""
    try:
        lines = (root / "proc/self/cgroup").read_text().splitlines()
    except OSError:
        lines = ["0::/", ":cpu:/"]
    for line in lines:
        _, controllers, group = line.split(":", 2)
        if not controllers:
            hierarchy = root / "sys/fs/cgroup"
        elif "cpu" in controllers.split(","):
            hierarchy = root / "sys/fs/cgroup" / controllers
        else:
            continue
        here = hierarchy / group.lstrip("/")
        for folder in (here, *here.parents):
            yield from _quota(folder)
            if folder == hierarchy:
                break


def _quota(folder: Path) -> Iterator[float]:
    """Microseconds of a core in a period of microseconds; "max" and -1 are none."""
    for names in (("cpu.max",), ("cpu.cfs_quota_us", "cpu.cfs_period_us")):
        try:
            quota, period = " ".join((folder / name).read_text() for name in names).split()
            if float(quota) > 0:
                yield float(quota) / float(period)
        except (OSError, ValueError):
            continue
