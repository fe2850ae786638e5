"""The oldest and the newest onnxruntime that `pyproject.toml` allows, each in a folder of its own: `out/onnxruntime`.

The other packages are those of the tests. Remove the folder to look for a newer version again.
"""

import fcntl
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "out/onnxruntime"
VERSIONS = ("oldest", "newest")


def run_with_onnxruntime(version: str, *command: object, timeout_s: float = 240) -> "subprocess.CompletedProcess[str]":
    """Run the command line of this toolkit with the "oldest" or the "newest" onnxruntime.

    Skips the test if the package cannot be fetched.
    """
    arguments = [sys.executable, "-m", "duospacenet.cli.main", *map(str, command)]
    path = os.pathsep.join([str(_installed(version)), str(ROOT)])
    environment = {**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": "1"}
    return subprocess.run(
        arguments, capture_output=True, text=True, check=False, env=environment, timeout=timeout_s, cwd=FOLDER
    )


def lower_bound() -> str:
    """The oldest version that `pyproject.toml` allows, such as "1.30"."""
    (bound,) = re.findall(r">=([\d.]+)", str(_requirement().specifier))
    return bound


def _requirement() -> Requirement:
    dependencies = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    (found,) = [each for each in map(Requirement, dependencies) if each.name == "onnxruntime"]
    return found


def _installed(version: str) -> Path:
    """The folder with onnxruntime alone. It is created if needed (5 seconds)."""
    wanted = f"onnxruntime=={lower_bound()}" if version == "oldest" else str(_requirement())
    folder = FOLDER / version
    FOLDER.mkdir(parents=True, exist_ok=True)
    # Several workers of pytest may need the folder at once: the first one creates it, and the others wait.
    with (FOLDER / f".{version}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        stamp = folder / "requirement.txt"  # written last
        if not stamp.exists() or stamp.read_text() != wanted:
            _install(wanted, folder)
            stamp.write_text(wanted)
    return folder


def _install(requirement: str, folder: Path) -> None:
    shutil.rmtree(folder, ignore_errors=True)
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-deps"]
    command += ["--only-binary", ":all:", "--target", str(folder), requirement]
    # The Makefile's constraints pin the version of the other tests.
    environment = {name: value for name, value in os.environ.items() if name != "PIP_CONSTRAINT"}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment, timeout=300)
    if done.returncode != 0:
        shutil.rmtree(folder, ignore_errors=True)
        pytest.skip(f"{requirement} cannot be fetched: {done.stderr.strip()[-300:]}")
