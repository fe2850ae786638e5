"""Workers on a Ray cluster: Ray Data gives the scenes to a pool of actors. See `ray_driver.py` for its process."""

import os
import re
import shutil
import socket
import tempfile
from collections.abc import Generator, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path

from ...runtime.errors import CheckError, UsageError
from ...runtime.extras import needs_extra
from ...runtime.printable import printable
from .batch_events import BatchEvent, SceneEnded
from .batch_records import BatchSettings, SceneOutcome
from .child_process import ChildProcess, ProcessLostError
from .scene_list import Scene

LOCAL = "local"
CONNECT_S = 10.0
END_S = 30.0  # for Ray to end its processes

# Variables of the process that starts Ray, and of the processes of Ray on this machine.
QUIET = {
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_USAGE_STATS_REPORT_URL": "http://127.0.0.1:9",  # a closed port: Ray sends a report even when reports are off
    "RAY_BACKEND_LOG_LEVEL": "fatal",
}
# Otherwise Ray listens on all interfaces, also if it is told the address 127.0.0.1 (Ray 2.60). The name is about other
# systems, but Ray reads the variable on all of them.
LOOPBACK = {"RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0"}
# Ray's dashboard process looks for this file in the home folder. Without it, the process asks the metadata services of
# three clouds where it is, also with the dashboard and the usage reports switched off (Ray 2.60).
BOOTSTRAP_NAME = "ray_bootstrap_config.yaml"


def check_ray(address: str) -> None:
    """Check the form of an address, and that Ray is installed. Raises UsageError and MissingExtraError.

    HOST:PORT is connected to: Ray itself tries for several minutes.
    """
    host, _, port = address.rpartition(":")
    is_local = address in (LOCAL, "auto")
    if not is_local and ("://" in address or not host or not re.fullmatch("[0-9]{1,5}", port)):
        raise UsageError(
            f"--ray: expected local, auto or HOST:PORT; got {address!r}. Start the command on a machine of the cluster "
            "for auto, or give the address of its head node, as `ray start` prints it."
        )
    with needs_extra("ray"):
        if find_spec("ray") is None or find_spec("pyarrow") is None:  # an import would take seconds
            raise ImportError(name="ray" if find_spec("ray") is None else "pyarrow")
    if not is_local:
        try:
            socket.create_connection((host.strip("[]"), int(port)), CONNECT_S).close()
        except (OSError, OverflowError, UnicodeError) as error:
            raise UsageError(
                f"--ray: expected a Ray cluster at {address}; it cannot be reached ({error}). Start one with ray start "
                "--head, or give its address."
            ) from None


def run_on_ray(
    settings: BatchSettings, scenes: Sequence[Scene], workers: int | None, address: str, cores: int
) -> Generator[BatchEvent, None, None]:
    """Run scenes on the actors of a Ray cluster, and yield what happens. Close the iterator to end the actors.

    workers: number of actors; None for as many as the cores of the cluster allow.
    address: LOCAL starts Ray on this machine with `cores` cores, and ends it again.

    Raises the DuoSpaceNetError of an actor that cannot load the bundle, and CheckError if the driver process is lost.
    """
    folder = _new_folder()
    driver = ChildProcess("ray_driver", [], _environment(address, folder))
    left = {scene.scene_id: scene for scene in scenes}
    try:
        request = {
            "settings": vars(settings),
            "scenes": [scene.to_dict() for scene in scenes],
            "address": address,
            "workers": workers,
            "cores": cores,
            "folder": str(folder),
            "home": os.environ.get("HOME", ""),
        }
        driver.send(request)
        while "end" not in (reply := driver.receive()):
            outcome = SceneOutcome.model_validate(reply["outcome"])
            if left.pop(outcome.scene, None) is not None:  # Ray may run a task twice
                yield SceneEnded(outcome.scene, outcome)
    except ProcessLostError as error:
        raise CheckError(f"--ray: the process that drives Ray has ended ({error}). Add --resume to continue.") from None
    finally:
        driver.end()
        driver.wait(END_S)
        driver.close()
        shutil.rmtree(folder, ignore_errors=True)
    for scene in left.values():
        yield SceneEnded(scene.scene_id, _no_result(scene))


def _new_folder() -> Path:
    """A folder for the files and sockets of Ray. The path of a socket has at most 107 bytes, and Ray adds about 65."""
    base = tempfile.gettempdir()
    return Path(tempfile.mkdtemp(prefix="duospacenet-ray-", dir=base if len(os.fsencode(base)) <= 20 else "/tmp"))


def _environment(address: str, folder: Path) -> Mapping[str, str]:
    if address != LOCAL:
        return os.environ | QUIET
    (folder / BOOTSTRAP_NAME).write_text("{}\n")
    own = {name: value for name, value in os.environ.items() if not name.startswith("RAY_")}
    return own | QUIET | LOOPBACK | {"HOME": str(folder)}


def _no_result(scene: Scene) -> SceneOutcome:
    cause = "Ray returned no result. Its logs may say why; --resume tries the scene again"
    return SceneOutcome(scene=scene.scene_id, source=printable(scene.source), folder="", status="failed", cause=cause)
