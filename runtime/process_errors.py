"""Errors of a job with several processes: each of them ends, and one of them says why."""

from .errors import INTERRUPTED_EXIT_CODE, DuoSpaceNetError


class LostProcessError(DuoSpaceNetError):
    """Another process of the same job was killed, or cannot be reached."""

    exit_code = INTERRUPTED_EXIT_CODE


class OtherProcessError(DuoSpaceNetError):
    """Another process of the same job has failed and reports its error. This process ends with the same exit code."""

    def __init__(self, exit_code: int) -> None:
        super().__init__(f"another process of this job failed with exit code {exit_code}")
        self.exit_code = exit_code
