"""The peak memory of this process."""

import resource


def peak_memory_gb() -> float:
    """The largest resident set size of this process so far, in GB (Linux)."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
