"""The option --history-step of jobs that run a stream."""

from ..runtime.bundle.manifest import Manifest
from ..runtime.errors import UsageError
from ..runtime.window_selection import WindowSelection


def check_history_step(step_s: float | None, manifest: Manifest) -> None:
    """Check the time between two frames of the temporal window. Raises UsageError that names the option."""
    window = manifest.window
    try:
        WindowSelection(window.num_frames - 1, step_s, window.largest_time_delta_s)
    except UsageError as error:
        raise UsageError(f"--history-step: {str(error).partition(': ')[2]}") from None
