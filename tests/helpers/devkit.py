"""nuscenes-devkit 1.2.0 in an environment of its own, `out/devkit`, because it needs numpy below 2.

Scripts in `tests/helpers/devkit_scripts` run in it and print JSON. They import the devkit and nothing of ours.
"""

import fcntl
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

REQUIREMENTS = Path(__file__).with_name("devkit_requirements.txt")
SCRIPTS = Path(__file__).with_name("devkit_scripts")
ENVIRONMENT = Path(__file__).parents[2] / "out/devkit"
PYTHONS = ("python3.12", "python3.11")  # numpy 1.26 has no wheels for later versions


def devkit_python() -> Path:
    """The interpreter of the devkit's environment, which is created if needed (20 seconds).

    Skips the test if the packages cannot be fetched, or if there is no Python that they support.
    """
    ENVIRONMENT.parent.mkdir(exist_ok=True)
    # Several workers of pytest may need the environment at once: the first one creates it, and the others wait.
    with ENVIRONMENT.with_name(".devkit.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not _is_complete():
            _create()
    return ENVIRONMENT / "bin/python"


def run_devkit(script: str, *arguments: object) -> Any:
    """Run a script of `devkit_scripts` with arguments, and return the JSON that it prints."""
    command = [devkit_python(), SCRIPTS / script, *map(str, arguments)]
    environment = {**os.environ, "MPLBACKEND": "Agg"}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def _is_complete() -> bool:
    """Whether the environment has the required packages. Its copy of the requirements is written last."""
    copy = ENVIRONMENT / REQUIREMENTS.name
    return copy.exists() and copy.read_bytes() == REQUIREMENTS.read_bytes()


def _create() -> None:
    shutil.rmtree(ENVIRONMENT, ignore_errors=True)
    subprocess.run([_find_python(), "-m", "venv", ENVIRONMENT], check=True, capture_output=True)
    command = [ENVIRONMENT / "bin/python", "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    command += ["--no-deps", "--only-binary", ":all:", "--requirement", REQUIREMENTS]
    # The Makefile's constraints are those of this toolkit, which has other versions of numpy and matplotlib.
    without_constraints = {name: value for name, value in os.environ.items() if name != "PIP_CONSTRAINT"}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=without_constraints)
    if done.returncode != 0:
        pytest.skip(f"the packages of nuscenes-devkit cannot be fetched: {done.stderr.strip()[-300:]}")
    shutil.copy(REQUIREMENTS, ENVIRONMENT)


def _find_python() -> str:
    if sys.version_info < (3, 13):
        return sys.executable
    for name in PYTHONS:
        path = shutil.which(name)
        if path and subprocess.run([path, "-c", ""], check=False, capture_output=True).returncode == 0:
            return path
    pytest.skip(f"nuscenes-devkit needs {' or '.join(PYTHONS)}, because numpy 1.26 has no wheels for later versions")
