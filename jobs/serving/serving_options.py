"""How a server runs a bundle: its vehicles, instances and threads, and the settings of each vehicle's stream."""

import math
import re
from dataclasses import dataclass

from ...runtime.bundle.manifest import Manifest
from ...runtime.cores import check_thread_count
from ...runtime.errors import UsageError
from ...runtime.lost_cameras import check_missing_camera_policy
from ...runtime.window_selection import WindowSelection

MAX_VEHICLES = 4096
MAX_INSTANCES = 64
MAX_IDLE_S = 86_400.0
NAME_PATTERN = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")


@dataclass(frozen=True)
class ServingOptions:
    """The settings of a model on a server.

    name: of the model, by which clients call it.
    vehicles: number of sequences that are processed at the same time; more of them wait.
    idle_s: a sequence without a request for this long loses its place [s].
    instances: processes that run the model. Each has its own copy of the graphs and its share of the vehicles.
    threads: of each instance; None for its share of the cores that are available when the server starts.
    on_missing, history_step_s: as for `Pipeline.stream`.
    """

    name: str = "duospacenet"
    vehicles: int = 8
    idle_s: float = 60.0
    instances: int = 1
    threads: int | None = None
    on_missing: str = "blank"
    history_step_s: float | None = None

    @property
    def sequences_per_instance(self) -> int:
        """The vehicles of an instance, rounded up."""
        return math.ceil(self.vehicles / self.instances)

    def check(self, manifest: Manifest) -> None:
        """Raise UsageError for a value that no server can use, or that does not fit the bundle."""
        if not NAME_PATTERN.fullmatch(self.name):
            raise UsageError(
                f"--name: expected up to 64 letters, digits, '_', '-' and '.', the first a letter or a digit; "
                f"got {self.name!r}."
            )
        _check_range("--vehicles", self.vehicles, 1, MAX_VEHICLES)
        _check_range("--instances", self.instances, 1, min(MAX_INSTANCES, self.vehicles))
        if self.threads is not None:
            check_thread_count(self.threads)
        check_missing_camera_policy(self.on_missing)
        window = manifest.window
        WindowSelection(window.num_frames - 1, self.history_step_s, window.largest_time_delta_s)
        # After a longer gap, the history is reset anyway. A shorter time would end sequences that can be continued.
        _check_range("--idle-seconds", self.idle_s, window.largest_time_delta_s, MAX_IDLE_S)


def _check_range(option: str, value: float, lowest: float, highest: float) -> None:
    if not lowest <= value <= highest:
        raise UsageError(f"{option}: expected {lowest:g} to {highest:g}; got {value:g}.")
