"""What can go wrong for a user: a class a kind, each with the exit code the command line ends with."""


class DuoSpaceNetError(Exception):
    """A failure with a message for a person: what was expected, what was got, what to do."""

    exit_code = 1


class CheckError(DuoSpaceNetError):
    """A check failed: parity, liveness."""

    exit_code = 1


class UsageError(DuoSpaceNetError):
    """The call's words are off: an unknown preset, options that contradict each other."""

    exit_code = 2


class InputError(DuoSpaceNetError):
    """Bad input data: a frame, an image, a calibration, a scene file."""

    exit_code = 3


class ArtifactError(DuoSpaceNetError):
    """A bad or untrusted artifact: a bundle or a checkpoint."""

    exit_code = 4


class OutputError(DuoSpaceNetError):
    """The place to write to exists already, or cannot be written."""

    exit_code = 5


class MissingExtraError(DuoSpaceNetError):
    """A package of an optional extra is not installed."""

    exit_code = 6
