"""Commands with a closed stdout or stderr, a reader that has gone, or an encoding that lacks a character."""

import json
import os
import subprocess
from collections.abc import Iterator

import pytest

from tests.helpers.processes import COMMAND, call

PRINTING = [
    ["--help"],
    ["run", "--help"],
    ["config", "show", "tiny"],
    ["inspect", "{bundle}"],
    ["inspect", "{bundle}", "--json"],
]


@pytest.fixture
def broken_pipe() -> Iterator[int]:
    """The writing end of a pipe without a reader."""
    reader, writer = os.pipe()
    os.close(reader)
    yield writer
    os.close(writer)


@pytest.mark.parametrize("arguments", PRINTING)
def test_a_command_ends_quietly_if_the_reader_of_its_output_has_gone(tiny_bundle, broken_pipe, arguments):
    done = call([part.format(bundle=tiny_bundle) for part in arguments], **captured_stderr(stdout=broken_pipe))
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("arguments", PRINTING)
def test_a_command_ends_quietly_if_stdout_is_closed(tiny_bundle, arguments):
    closed = captured_stderr(stdout=None, preexec_fn=lambda: os.close(1))
    done = call([part.format(bundle=tiny_bundle) for part in arguments], **closed)
    assert (done.returncode, done.stderr) == (0, "")


def captured_stderr(**options) -> dict:
    return {"capture_output": False, "stderr": subprocess.PIPE} | options


def test_a_failed_command_keeps_its_exit_code_without_a_reader(tmp_path, broken_pipe):
    for options in ({"stdout": broken_pipe}, {"stdout": None, "preexec_fn": lambda: os.close(1)}):
        done = call(["inspect", tmp_path / "none", "--json"], **captured_stderr(**options))
        assert done.returncode == 4
        assert done.stderr.startswith("error: ")
    no_streams = {"capture_output": False, "preexec_fn": lambda: (os.close(1), os.close(2))}
    assert call(["inspect", tmp_path / "none"], **no_streams).returncode == 4


def test_a_run_without_standard_streams_writes_its_results(tiny_bundle, tmp_path):
    """A file that is opened first must not become stdout."""
    closed = {"capture_output": False, "preexec_fn": lambda: [os.close(descriptor) for descriptor in range(3)]}
    done = call(["run", tiny_bundle, "synthetic:5:2", "--out", tmp_path, "--json"], **closed)
    assert done.returncode == 0
    assert len([json.loads(line) for line in (tmp_path / "results.jsonl").read_text().splitlines()]) == 2


def test_a_character_that_the_encoding_lacks_becomes_a_question_mark(tmp_path):
    ascii_only = {"LC_ALL": "C", "LANG": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    done = subprocess.run(
        [*COMMAND, "inspect", str(tmp_path / "écran")], env=os.environ | ascii_only, capture_output=True, check=False
    )
    assert done.returncode == 4
    assert b"Traceback" not in done.stderr
