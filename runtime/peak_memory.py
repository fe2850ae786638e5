"""The peak memory of this process."""

import re
import resource
from pathlib import Path


def peak_memory_gb(status: Path = Path("/proc/self/status")) -> float:
    """The largest resident set size of this process so far, in GB (Linux).

    status: the process's status file. `getrusage` alone is not enough: its figure also covers the process that started
    this one, as it was before the program of this one was loaded.
    """
    try:
        found = re.search(r"^VmHWM:\s*(\d+) kB$", status.read_text(), re.MULTILINE)
    except OSError:
        found = None
    kibibytes = int(found[1]) if found else resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return kibibytes * 1024 / 1e9
