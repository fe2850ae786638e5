"""Builds and runs the C++ consumer with sanitizers, and builds it with faults.

The build is in `out/consumers/cpp-sanitized`, so only the first test run compiles everything. As a script, this file
prints the folder with the CMake files of OpenVINO.
"""

import fcntl
import importlib.util
import json
import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SOURCES = ROOT / "consumers" / "cpp"
BUILD = ROOT / "out" / "consumers" / "cpp-sanitized"
COMMAND = BUILD / "duospacenet_cpp"
UNIT_TESTS = BUILD / "unit_tests"

_SUPPRESSIONS = SOURCES / "tests" / "leak_suppressions.txt"
_SANITIZER_EXIT_CODE = 99  # no other error has it
_TOOLS = ("cmake", "ninja", "g++")
_HEADERS = ("opencv4/opencv2/imgcodecs.hpp", "nlohmann/json.hpp", "openssl/evp.h", "turbojpeg.h", "doctest/doctest.h")
_BUILD_TIMEOUT_S = 580
_RUN_TIMEOUT_S = 120


def missing_parts() -> str:
    """Return what the build needs and this machine lacks, or an empty text."""
    missing = [tool for tool in _TOOLS if shutil.which(tool) is None]
    missing += [header for header in _HEADERS if not Path("/usr/include", header).exists()]
    if openvino_cmake_folder() is None:
        missing.append("the CMake files of the openvino wheel")
    return ", ".join(missing)


def openvino_cmake_folder() -> Path | None:
    """Return the folder with the CMake files of the openvino wheel, without importing it."""
    spec = importlib.util.find_spec("openvino")
    if spec is None or spec.origin is None:
        return None
    folder = Path(spec.origin).parent / "cmake"
    return folder if folder.is_dir() else None


def build() -> None:
    """Build the command and the unit tests. Skips the test if something is missing for that."""
    if missing := missing_parts():
        pytest.skip(f"the C++ consumer cannot be built without {missing}: run consumers/install_packages.sh")
    BUILD.mkdir(parents=True, exist_ok=True)
    with (BUILD / "lock").open("w") as lock:  # two workers of pytest may build at the same time
        fcntl.flock(lock, fcntl.LOCK_EX)
        configure = ["cmake", "-S", SOURCES, "-B", BUILD, "-G", "Ninja", f"-DOpenVINO_DIR={openvino_cmake_folder()}"]
        options = ["-DSANITIZE=ON", "-DBUILD_TESTS=ON", "-DCMAKE_BUILD_TYPE=None", "-DCMAKE_CXX_FLAGS=-O0"]
        for command in ([*configure, *options], ["cmake", "--build", BUILD]):
            done = subprocess.run(command, capture_output=True, text=True, timeout=_BUILD_TIMEOUT_S, check=False)
            assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-4000:]


def call(*arguments: object, program: Path = COMMAND, **options) -> subprocess.CompletedProcess:
    """Run the command with sanitizers, and wait for its end. Fails if a sanitizer reports an error.

    program: another executable of the build. options: of `subprocess.run`.
    """
    command = [str(program), *map(str, arguments)]
    environment = os.environ | {
        "ASAN_OPTIONS": f"exitcode={_SANITIZER_EXIT_CODE}",
        "LSAN_OPTIONS": f"suppressions={_SUPPRESSIONS}:print_suppressions=0:exitcode={_SANITIZER_EXIT_CODE}",
        "UBSAN_OPTIONS": f"print_stacktrace=1:exitcode={_SANITIZER_EXIT_CODE}",
        "TBB_ENABLE_SANITIZERS": "1",  # TBB opens a library in a way that AddressSanitizer does not support
    }
    defaults = {"capture_output": True, "text": True, "check": False, "timeout": _RUN_TIMEOUT_S, "env": environment}
    done = subprocess.run(command, **defaults | options)
    assert done.returncode != _SANITIZER_EXIT_CODE, done.stderr[-6000:]
    return done


def build_with_fault(folder: Path, source: str, line: str, faulty_line: str) -> Path:
    """Build the command with one line of one source file replaced. Returns the executable, in `folder`.

    source: name of the file in `consumers/cpp/src`. line: a text that is in it once.
    """
    text = (SOURCES / "src" / source).read_text()
    assert text.count(line) == 1, line
    (folder / source).write_text(text.replace(line, faulty_line))
    compiled = folder / f"{source}.o"
    _run([*_compile_command(source), "-c", str(folder / source), "-o", str(compiled)])
    # The object comes before the library, so the library's version of it is not used.
    linked = _run(["ninja", "-t", "commands", COMMAND.name]).splitlines()[-1]
    program = folder / COMMAND.name
    arguments = shlex.split(linked.removeprefix(": && ").removesuffix(" && :"))
    arguments[arguments.index("-o") : arguments.index("-o") + 2] = [str(compiled), "-o", str(program)]
    _run(arguments)
    return program


def _compile_command(source: str) -> list[str]:
    """Return the command that compiles a source file, without the names of the file and of its output."""
    entries = json.loads((BUILD / "compile_commands.json").read_text())
    arguments = next(shlex.split(entry["command"]) for entry in entries if Path(entry["file"]).name == source)
    return arguments[: arguments.index("-o")]


def _run(command: Sequence[str]) -> str:
    done = subprocess.run(command, cwd=BUILD, capture_output=True, text=True, timeout=_BUILD_TIMEOUT_S, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


if __name__ == "__main__":
    sys.stdout.write(f"{openvino_cmake_folder()}\n")
