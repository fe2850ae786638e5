"""The option --history-step of jobs that run a stream."""

from ..runtime.bundle.manifest import Manifest
from ..runtime.errors import UsageError
from ..runtime.window_selection import WindowSelection


def check_history_step(step_s: float | None, manifest: Manifest, eager: bool = False) -> None:
    """Check the time between two frames of the temporal window. Raises UsageError that names the option.

    eager: whether the model runs in PyTorch, whose window always has the newest frames.
    """
    if eager and step_s is not None:
        raise UsageError(
            "--history-step: expected only without --eager, which has no such option. Leave one of them out."
        )
    window = manifest.window
    try:
        WindowSelection(window.num_frames - 1, step_s, window.largest_time_delta_s)
    except UsageError as error:
        raise UsageError(f"--history-step: {str(error).partition(': ')[2]}") from None
