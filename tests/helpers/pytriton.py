"""A real Triton without Docker: the server in the wheel of nvidia-pytriton, in an environment of its own, `out/triton`.

The Python backend of that server (Triton 2.51) does not support numpy 2, so the environment has numpy 1.26. The other
packages have the versions of this environment, so that results are equal bit for bit.
"""

import ctypes
import fcntl
import os
import shutil
import signal
import socket
import subprocess
import sys
import sysconfig
import time
import tomllib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

import pytest

REPOSITORY = Path(__file__).parents[2]
ENVIRONMENT = REPOSITORY / "out/triton"
REQUIREMENTS = Path(__file__).with_name("pytriton_requirements.txt")
SAME_VERSIONS = ("onnxruntime", "opencv-python-headless", "pydantic", "pydantic-core", "simplejpeg", "msgspec")
SAME_VERSIONS += ("annotated-types", "typing-extensions", "typing-inspection", "flatbuffers", "packaging")
PYTHON = f"{sys.version_info.major}.{sys.version_info.minor}"
SITE_PACKAGES = ENVIRONMENT / f"lib/python{PYTHON}/site-packages"
BACKENDS = ENVIRONMENT / "backends"
INSTALL_S, START_S, STOP_S = 300, 60, 20


class RunningServer(NamedTuple):
    """A server on this machine. url: of its gRPC service. log: what it prints."""

    url: str
    process: subprocess.Popen
    log: Path


def triton_python() -> Path:
    """The interpreter of the environment, which is created if needed (20 seconds).

    Skips the test if the packages cannot be fetched, or if the server cannot run with this Python.
    """
    if sys.version_info >= (3, 13):
        pytest.skip("Triton needs Python 3.11 or 3.12 here, because numpy 1.26 has no wheels for later versions")
    ENVIRONMENT.parent.mkdir(exist_ok=True)
    # Several workers of pytest may need the environment at once: the first one creates it, and the others wait.
    with ENVIRONMENT.with_name(".triton.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not _stamp().exists() or _stamp().read_text() != _requirements():
            _create()
        _link_toolkit()
    _check_libraries()
    return ENVIRONMENT / "bin/python"


@contextmanager
def running_triton(repository: Path, log: Path) -> Iterator[RunningServer]:
    """Start a server on free ports of 127.0.0.1, and wait until its models are loaded. It ends with the block."""
    triton_python()
    grpc_port, http_port = _free_ports(2)
    command = [SITE_PACKAGES / "pytriton/tritonserver/bin/tritonserver", f"--model-repository={repository}"]
    command += [f"--backend-directory={BACKENDS}", "--disable-auto-complete-config", "--allow-metrics=false"]
    command += ["--http-address=127.0.0.1", f"--http-port={http_port}", "--exit-timeout-secs=5"]
    command += ["--grpc-address=127.0.0.1", f"--grpc-port={grpc_port}"]
    region = f"duospacenet-test-{grpc_port}-"
    command += [f"--backend-config=python,shm-region-prefix-name={region}"]
    with log.open("wb") as output:
        process = subprocess.Popen(
            list(map(str, command)),
            stdout=output,
            stderr=subprocess.STDOUT,
            env=_variables(),
            preexec_fn=_end_with_parent,
        )
    try:
        _wait_until_loaded(process, log)
        yield RunningServer(f"127.0.0.1:{grpc_port}", process, log)
    finally:
        process.terminate()
        try:
            process.wait(STOP_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        _remove_leftovers(process.pid, region)


def run_client(script: Path, arguments: Sequence[object], timeout_s: float = 120) -> subprocess.CompletedProcess:
    """Run a script with the environment's tritonclient, and wait for its end."""
    command = [str(triton_python()), str(script), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=timeout_s)


def _requirements() -> str:
    """The packages of the environment, one per line."""
    same = [f"{name}=={version(name)}\n" for name in SAME_VERSIONS]
    return REQUIREMENTS.read_text() + "".join(same)


def _stamp() -> Path:
    """The file that is written last."""
    return ENVIRONMENT / "requirements.txt"


def _create() -> None:
    shutil.rmtree(ENVIRONMENT, ignore_errors=True)
    subprocess.run([sys.executable, "-m", "venv", ENVIRONMENT], check=True, capture_output=True, timeout=INSTALL_S)
    requirements = ENVIRONMENT / "requested.txt"
    requirements.write_text(_requirements())
    command = [ENVIRONMENT / "bin/python", "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    command += ["--no-deps", "--only-binary", ":all:", "--requirement", requirements]
    # The Makefile's constraints are those of this toolkit, which has another version of numpy.
    without_constraints = {name: value for name, value in os.environ.items() if name != "PIP_CONSTRAINT"}
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, env=without_constraints, timeout=INSTALL_S
    )
    if done.returncode != 0:
        pytest.skip(f"the packages of Triton cannot be fetched: {done.stderr.strip()[-300:]}")
    _make_backend()
    requirements.rename(_stamp())


def _link_toolkit() -> None:
    """Make the packages of this checkout importable. The backend's process ignores PYTHONPATH."""
    folders = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["tool"]["setuptools"]["package-dir"]
    package = SITE_PACKAGES / "duospacenet"
    package.mkdir(exist_ok=True)
    for name, folder in folders.items():
        part, target = (name.split(".")[1], folder) if "." in name else ("__init__.py", f"{folder}/__init__.py")
        if not (package / part).exists():
            (package / part).symlink_to(REPOSITORY / target)


def _make_backend() -> None:
    """Make a folder with the Python backend and its process for this version of Python."""
    server = SITE_PACKAGES / "pytriton/tritonserver"
    shutil.copytree(server / "backends/python", BACKENDS / "python")
    shutil.copy(server / "python_backend_stubs" / PYTHON / "triton_python_backend_stub", BACKENDS / "python")


def _variables() -> dict[str, str]:
    """The variables with which the server finds its libraries and the environment's Python."""
    libraries = [SITE_PACKAGES / "nvidia_pytriton.libs", sysconfig.get_config_var("LIBDIR")]
    path = f"{ENVIRONMENT / 'bin'}:{os.environ['PATH']}"
    return {**os.environ, "PATH": path, "LD_LIBRARY_PATH": ":".join(map(str, libraries))}


def _check_libraries() -> None:
    """Skip the test if a library is missing, for example the shared library of a Python that was built without it."""
    programs = [
        SITE_PACKAGES / "pytriton/tritonserver/bin/tritonserver",
        BACKENDS / "python/triton_python_backend_stub",
    ]
    done = subprocess.run(
        ["ldd", *map(str, programs)], capture_output=True, text=True, check=False, env=_variables(), timeout=30
    )
    missing = [line.strip() for line in done.stdout.splitlines() if "not found" in line]
    if done.returncode != 0 or missing:
        pytest.skip(f"Triton cannot run here: {'; '.join(missing) or done.stderr.strip()[-300:]}")


def _free_ports(count: int) -> list[int]:
    """Ports that are free now. All are open at the same time, so that they differ."""
    sockets = [socket.socket() for _ in range(count)]
    try:
        for each in sockets:
            each.bind(("127.0.0.1", 0))
        return [each.getsockname()[1] for each in sockets]
    finally:
        for each in sockets:
            each.close()


def _end_with_parent() -> None:
    """Let the kernel end the server when the tests end, however they end. It leads a process group of its own."""
    set_death_signal = 1  # PR_SET_PDEATHSIG
    ctypes.CDLL(None).prctl(set_death_signal, signal.SIGTERM)
    os.setpgid(0, 0)


def _remove_leftovers(group: int, region: str) -> None:
    """Kill the processes and remove the shared memory that a server leaves behind if it was killed."""
    with suppress(ProcessLookupError):
        os.killpg(group, signal.SIGKILL)
    for path in Path("/dev/shm").glob(f"{region}*"):
        path.unlink(missing_ok=True)


def _wait_until_loaded(process: subprocess.Popen, log: Path) -> None:
    start_s = time.monotonic()
    while b"Started GRPCInferenceService" not in log.read_bytes():
        assert process.poll() is None, log.read_text(errors="replace")[-3000:]
        assert time.monotonic() - start_s < START_S, log.read_text(errors="replace")[-3000:]
        time.sleep(0.05)
