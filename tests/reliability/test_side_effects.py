"""Side effects of libraries: row P9 of the reliability list. A command writes below `--out` only, and opens no
connection.

__pycache__ folders are Python's own, and are not written here. torch's shared memory in /dev/shm is removed at the end.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from duospacenet.data.scene_writer import write_scene
from duospacenet.model import PRESETS
from duospacenet.synthetic.drive import SyntheticDrive
from tests.helpers.output_files import contents
from tests.helpers.processes import COMMAND
from tests.helpers.streams import TINY_SIZE_PX
from tests.helpers.system_calls import (
    KILLED_BY_FILTER,
    can_forbid_internet,
    can_trace,
    forbid_internet,
    trace_command,
    written_paths,
)
from tests.helpers.train_command import TRAIN_TINY, with_options

TELEMETRY_STARTS_S = 10  # onnxruntime's telemetry looks up its host after 5 to 8 s, OpenVINO's when it is imported


class Host:
    """A new user account: empty home, temporary and working directories, and a bundle and a scene to read."""

    def __init__(self, folder: Path, bundle: Path) -> None:
        self.home, self.temporary, self.cwd, self.out = (folder / name for name in ("home", "tmp", "cwd", "out"))
        for path in (self.home, self.temporary, self.cwd):
            path.mkdir()
        self.bundle, self.scene = bundle, folder / "scene"
        grid = PRESETS["tiny"].voxels.size[:2]
        write_scene(self.scene, SyntheticDrive(1, frames=2, image_size=TINY_SIZE_PX, grid=grid))
        self._inputs = self._read_inputs()

    def environment(self, **variables: str) -> dict[str, str]:
        """The environment of a command, without what this test process has set, such as ORT_DISABLE_TELEMETRY."""
        kept = {name: os.environ[name] for name in ("PATH", "PYTHONPATH", "OMP_NUM_THREADS") if name in os.environ}
        own = {"HOME": str(self.home), "TMPDIR": str(self.temporary), "PYTHONDONTWRITEBYTECODE": "1"}
        return kept | own | variables

    def run(self, command: list[str], **options) -> subprocess.CompletedProcess:
        defaults = {"cwd": self.cwd, "env": self.environment(), "capture_output": True, "text": True, "timeout": 300}
        return subprocess.run(command, **defaults | options)

    def assert_nothing_left_outside_out(self) -> None:
        for folder in (self.home, self.temporary, self.cwd):
            assert not list(folder.rglob("*")), folder
        assert self._read_inputs() == self._inputs

    def may_be_written(self, path: Path) -> bool:
        """Whether a path is below `--out` or in a folder for temporary files, which is checked at the end."""
        allowed = (self.out, self.temporary, Path("/dev/null"), Path("/dev/shm"))
        return any(path.is_relative_to(folder) for folder in allowed)

    def _read_inputs(self) -> dict[str, bytes]:
        return {
            f"{folder}/{path}": data for folder in (self.bundle, self.scene) for path, data in contents(folder).items()
        }


@pytest.fixture
def host(tmp_path, copied_bundle) -> Host:
    return Host(tmp_path, copied_bundle)


def commands(host: Host) -> list[list[str]]:
    """Commands that import onnxruntime, OpenCV, matplotlib, foxglove, rerun and torch.

    A whole export would take longer.
    """
    bundle, scene, out = str(host.bundle), str(host.scene), host.out
    options = ["--draw", "--video", "--maps", "--format", "nuscenes"]
    return [
        ["run", bundle, scene, "--out", str(out / "run"), *options, "--recording", str(out / "drive.mcap")],
        ["run", bundle, scene, "--out", str(out / "second"), "--heatmaps", "--recording", str(out / "drive.rrd")],
        ["compare", str(out / "run"), str(out / "second"), scene, "--out", str(out / "compared")],
        ["inspect", bundle],
        ["check-rig", scene, "--out", str(out / "rig")],
        ["eval", bundle, scene, "--plots", str(out / "plots")],
        ["quantize", bundle, "--source", scene, "--no-metrics", "--out", str(out / "int8")],
        with_options(TRAIN_TINY, "--steps", "1", "--source", scene, "--out", str(out / "train")),
    ]


@pytest.mark.skipif(not can_forbid_internet(), reason="the filter is written for x86_64 and aarch64")
def test_p9_the_filter_kills_a_process_that_opens_an_internet_socket(host):
    for family, expected in (("AF_INET", KILLED_BY_FILTER), ("AF_INET6", KILLED_BY_FILTER), ("AF_UNIX", 0)):
        code = f"import socket; socket.socket(socket.{family})"
        assert host.run([sys.executable, "-c", code], preexec_fn=forbid_internet).returncode == expected


LOAD_AND_WAIT = """
import sys, time
from duospacenet.runtime import Pipeline
for engine in ("onnxruntime", "openvino"):
    Pipeline.load(sys.argv[1], engine=engine)
time.sleep(float(sys.argv[2]))
"""


@pytest.mark.skipif(not can_forbid_internet(), reason="the filter is written for x86_64 and aarch64")
def test_p9_a_pipeline_in_a_notebook_opens_no_connection_and_leaves_no_file(host):
    command = [sys.executable, "-c", LOAD_AND_WAIT, str(host.bundle), str(TELEMETRY_STARTS_S)]
    done = host.run(command, preexec_fn=forbid_internet)
    assert done.returncode == 0, done.stderr
    host.assert_nothing_left_outside_out()


def test_p9_commands_leave_no_file_outside_out_and_open_no_connection(host, tmp_path):
    """Under strace where it is allowed. Then a file that is removed again counts too, unless it is a temporary file."""
    filters = {"preexec_fn": forbid_internet} if can_forbid_internet() else {}
    for arguments in commands(host):
        command = [*COMMAND, *arguments]
        log = tmp_path / "trace"
        done = host.run(trace_command(command, log) if can_trace() else command, **filters)
        assert done.returncode == 0, (arguments, done.stderr)
        host.assert_nothing_left_outside_out()
        if can_trace():
            assert [path for path in written_paths(log, host.cwd) if not host.may_be_written(path)] == [], arguments


WRITE_AND_REMOVE = """
import os, sys
os.mkdir("folder")
open("folder/file", "w").close()
os.rename("folder/file", "moved")
os.remove("moved")
os.rmdir("folder")
open(sys.argv[1]).close()
"""


@pytest.mark.skipif(not can_trace(), reason="strace is not installed or not allowed")
def test_p9_the_trace_shows_files_that_are_removed_again_but_not_files_that_are_read(host, tmp_path):
    log, read = tmp_path / "trace", host.bundle / "manifest.json"
    host.run(trace_command([sys.executable, "-c", WRITE_AND_REMOVE, str(read)], log), check=True)
    paths = {host.cwd / name for name in ("folder", "folder/file", "moved")}
    assert written_paths(log, host.cwd) - {Path("/dev/null")} == paths


# --- what a user has chosen ---------------------------------------------------------------------------------------

PRINT_VARIABLE = "import os, duospacenet.runtime; print(os.environ['ORT_DISABLE_TELEMETRY'])"


@pytest.mark.parametrize("value", ["0", "1", ""])
def test_p9_a_users_choice_of_telemetry_is_kept(host, value):
    environment = host.environment(ORT_DISABLE_TELEMETRY=value)
    assert host.run([sys.executable, "-c", PRINT_VARIABLE], env=environment).stdout == f"{value}\n"


PRINT_FOLDER = """
import os
from duospacenet.evaluation import plots
import matplotlib
print(os.environ.get("MPLCONFIGDIR"), matplotlib.get_cachedir())
"""


def test_p9_a_users_folders_of_matplotlib_are_kept(host):
    cache = host.home / ".cache" / "matplotlib"
    cache.mkdir(parents=True)
    assert host.run([sys.executable, "-c", PRINT_FOLDER]).stdout == f"None {cache}\n"
    own = host.environment(MPLCONFIGDIR=str(host.cwd))
    assert host.run([sys.executable, "-c", PRINT_FOLDER], env=own).stdout == f"{host.cwd} {host.cwd}\n"
