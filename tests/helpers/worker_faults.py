"""Faults in the worker processes of a batch: a worker is killed, or waits, when it opens a chosen image.

Python imports `sitecustomize` from PYTHONPATH in every process. It watches the files that the process opens, and the
hosts that it connects to. The tests' own process was started earlier, so it has no faults.
"""

import json
from pathlib import Path

FAULTS_VARIABLE = "DUOSPACENET_TEST_FAULTS"
_CODE = """
import json, os, pathlib, signal, sys, time

faults = json.loads(os.environ["DUOSPACENET_TEST_FAULTS"])

def watch(event, arguments):
    if event == "socket.connect" and isinstance(arguments[1], tuple):
        log(arguments[1][0])
    elif event == "socket.getaddrinfo":
        log(arguments[0])
    elif event == "open" and isinstance(arguments[0], str):
        follow_faults(arguments)

def log(host):
    with open(os.environ["DUOSPACENET_TEST_HOSTS"], "a") as file:
        file.write(f"{host}\\n")

def follow_faults(arguments):
    for fault in faults:
        if arguments[0].endswith(fault["image"]) and has_content(fault["results"]):
            if fault["token"] is not None:
                try:
                    os.unlink(fault["token"])
                except FileNotFoundError:
                    continue
            if fault["until"] is None:
                os.kill(os.getpid(), signal.SIGKILL)
            while os.path.exists(fault["until"]):
                time.sleep(0.02)

def has_content(path):
    return os.path.exists(path) and os.path.getsize(path) > 0

sys.addaudithook(watch)
"""


class WorkerFaults:
    """Faults of a batch with the results in `out`. They happen after the first frame of a scene was written."""

    def __init__(self, folder: Path, out: Path) -> None:
        """folder: a new folder for the files of the faults."""
        folder.mkdir()
        self._folder, self._out, self._faults = folder, out, []
        (folder / "sitecustomize.py").write_text(_CODE)
        self._barrier = folder / "barrier"
        self._barrier.touch()
        self._hosts = folder / "hosts"
        self._hosts.touch()

    def kill(self, scene: Path, frame: int, *, once: bool) -> None:
        """Kill the process that opens an image of this frame: each time, or only the first one."""
        self._add(scene, frame, once, until=None)

    def wait(self, scene: Path, frame: int) -> None:
        """Let a process that opens an image of this frame wait until `go_on`."""
        self._add(scene, frame, once=False, until=str(self._barrier))

    def go_on(self) -> None:
        """Let waiting processes go on."""
        self._barrier.unlink()

    def environment(self) -> dict[str, str]:
        """The variables of the command that starts the workers."""
        hosts = {"DUOSPACENET_TEST_HOSTS": str(self._hosts)}
        return hosts | {"PYTHONPATH": str(self._folder), FAULTS_VARIABLE: json.dumps(self._faults)}

    def hosts(self) -> set[str]:
        """The hosts that Python code in these processes has looked up or connected to."""
        return set(self._hosts.read_text().split())

    def _add(self, scene: Path, frame: int, once: bool, until: str | None) -> None:
        token = self._folder / f"token-{len(self._faults)}"
        token.touch()
        self._faults.append(
            {
                "image": f"/{scene.name}/images/CAM_FRONT/{frame:06d}.png",
                "results": str(self._out / "unfinished" / scene.name / "results.jsonl"),
                "token": str(token) if once else None,
                "until": until,
            }
        )
