"""The browser consumer: its npm packages, and its commands and tests in Node."""

import fcntl
import hashlib
import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "consumers" / "browser"
CHROMIUM = Path("/usr/bin/chromium")
OLDEST_NODE = (20, 19)
INSTALL_TIMEOUT_S, TIMEOUT_S = 240, 500


def install() -> None:
    """Install the npm packages of package-lock.json, unless they are installed. Skips the test if that is not possible.

    Several processes may call it at the same time.
    """
    _check_node()
    digest = hashlib.sha256((FOLDER / "package-lock.json").read_bytes()).hexdigest()
    stamp = FOLDER / "node_modules" / ".installed"
    with (FOLDER / "package-lock.json").open() as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if stamp.exists() and stamp.read_text() == digest:
            return
        done = _run("npm", "ci", timeout=INSTALL_TIMEOUT_S)
        if done.returncode != 0:
            pytest.skip(f"npm ci failed: {done.stderr.strip()[-200:]}")
        stamp.write_text(digest)


def build() -> None:
    """Build the page. Skips the test without Chromium."""
    install()
    if not CHROMIUM.exists():
        pytest.skip(f"{CHROMIUM} is not installed: run consumers/install_packages.sh")
    done = _run("npm", "run", "build")
    assert done.returncode == 0, done.stderr


def call(*command: object) -> subprocess.CompletedProcess[str]:
    """Run a command of the consumer, for example `call("node", "node/verify.js", bundle)`."""
    return _run(*command)


def run_tests(script: str, fixtures: Path) -> str:
    """Run a test script of package.json. Returns its report, and fails if a test fails or is skipped."""
    done = subprocess.run(
        ["npm", "run", script],
        cwd=FOLDER,
        env=_environment() | {"DUOSPACENET_FIXTURES": str(fixtures)},
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
    )
    report = done.stdout + done.stderr
    assert done.returncode == 0, report[-8000:]
    assert re.search(r"^\S+ skipped 0$", report, re.MULTILINE), report[-2000:]
    return report


def _check_node() -> None:
    for program in ("node", "npm"):
        if shutil.which(program) is None:
            pytest.skip(f"{program} is not installed; the browser consumer needs Node {_dotted(OLDEST_NODE)} and npm")
    found = _run("node", "--version").stdout
    version = tuple(int(part) for part in re.findall(r"\d+", found)[:2])
    if version < OLDEST_NODE:
        pytest.skip(f"the browser consumer needs Node {_dotted(OLDEST_NODE)} or later; found {found.strip()}")


def _run(*command: object, timeout: float = TIMEOUT_S) -> subprocess.CompletedProcess[str]:
    arguments = [str(part) for part in command]
    return subprocess.run(
        arguments, cwd=FOLDER, env=_environment(), capture_output=True, text=True, timeout=timeout, check=False
    )


def _environment() -> dict[str, str]:
    """The environment of this process, without variables that change what Node and its test runner do."""
    return {name: value for name, value in os.environ.items() if not name.startswith(("NODE_", "DUOSPACENET_"))}


def _dotted(version: tuple[int, ...]) -> str:
    return ".".join(map(str, version))
