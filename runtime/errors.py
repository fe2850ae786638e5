"""The errors that a user can cause, one class per exit code of the command line.

Exit codes: 0 success, 1 failed check, 2 wrong usage, 3 bad input data, 4 bad artifact, 5 output, 6 missing extra,
70 internal error, 130 interrupted.
"""

INTERNAL_ERROR_EXIT_CODE = 70  # EX_SOFTWARE of sysexits.h
INTERRUPTED_EXIT_CODE = 130  # 128 + SIGINT, as shells report it


class DuoSpaceNetError(Exception):
    """The base class. Each message tells a user what was expected, what was found, and what to do."""

    exit_code = INTERNAL_ERROR_EXIT_CODE


class CheckError(DuoSpaceNetError):
    """A check failed, such as parity or the calibration of a rig."""

    exit_code = 1


class UsageError(DuoSpaceNetError):
    """A wrong call, such as an unknown preset or options that contradict each other."""

    exit_code = 2


class InputError(DuoSpaceNetError):
    """Bad input data: a frame, an image, a calibration, a scene file, a configuration file."""

    exit_code = 3


class ArtifactError(DuoSpaceNetError):
    """A bad or untrusted artifact: a bundle or a checkpoint."""

    exit_code = 4


class OutputError(DuoSpaceNetError):
    """The output exists already or cannot be written."""

    exit_code = 5


class MissingExtraError(DuoSpaceNetError):
    """A package of an optional extra is not installed."""

    exit_code = 6
