"""The errors a user can cause or meet. Each class has the exit code of the command line."""


class DuoSpaceNetError(Exception):
    """An error with a message for the user: what was expected, what was found, what to do."""

    exit_code = 1


class CheckError(DuoSpaceNetError):
    """A check failed, for example parity or liveness."""

    exit_code = 1


class UsageError(DuoSpaceNetError):
    """Wrong arguments: for example an unknown preset, or options that contradict each other."""

    exit_code = 2


class InputError(DuoSpaceNetError):
    """Bad input data: a frame, an image, a calibration or a scene file."""

    exit_code = 3


class ArtifactError(DuoSpaceNetError):
    """A bad or untrusted artifact: a bundle or a checkpoint."""

    exit_code = 4


class OutputError(DuoSpaceNetError):
    """The output exists already, or cannot be written."""

    exit_code = 5


class MissingExtraError(DuoSpaceNetError):
    """A package of an optional extra is not installed."""

    exit_code = 6
