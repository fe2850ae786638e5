"""Ctrl-C, SIGTERM and SIGHUP end a command with exit code 130, after its clean-up."""

import os
import pty
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers.processes import COMMAND, popen, start, wait_for

SLOW_MODULE = """
import os, signal, time
os.kill(os.getpid(), signal.{name})
time.sleep(0.1)
finished = True
"""
IMPORT_IT = """
import signal, time
from duospacenet.cli.interruptions import catch_interruptions
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # it is ignored if the suite runs under nohup
catch_interruptions()
try:
    import slow_module
    time.sleep(10)
except KeyboardInterrupt:
    print("interrupted", slow_module.finished)
"""


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_an_interruption_during_an_import_waits_for_its_end(tmp_path, name):
    (tmp_path / "slow_module.py").write_text(SLOW_MODULE.format(name=name))
    done = subprocess.run([sys.executable, "-c", IMPORT_IT], cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert (done.stdout, done.stderr) == ("interrupted True\n", "")


@pytest.mark.parametrize("name", ["SIGHUP", "SIGTERM"])
def test_an_interrupted_export_leaves_no_staging_folder(tmp_path, name):
    process = start(["export", "--preset", "tiny", "--random-weights", "--out", tmp_path / "bundle"])
    wait_for(lambda: list(tmp_path.glob(".bundle.*/*.onnx")), timeout_s=300)
    process.send_signal(getattr(signal, name))
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "interrupted" in err
    assert "Traceback" not in err
    assert list(tmp_path.iterdir()) == []


def test_an_interrupted_run_keeps_whole_lines_after_sighup(tiny_bundle, tmp_path):
    process = start(["run", tiny_bundle, "synthetic:1:2000", "--out", tmp_path])
    wait_for(lambda: lines_in(tmp_path) >= 2)
    process.send_signal(signal.SIGHUP)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Traceback" not in err
    assert (tmp_path / "results.jsonl").read_bytes().endswith(b"\n")


def test_nohup_protects_a_run_from_sighup(tiny_bundle, tmp_path):
    command = ["nohup", *COMMAND, "run", str(tiny_bundle), "synthetic:1:12", "--out", str(tmp_path)]
    process = popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    wait_for(lambda: lines_in(tmp_path) >= 2)
    process.send_signal(signal.SIGHUP)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    assert lines_in(tmp_path) == 12


def test_a_command_ends_with_130_when_its_terminal_is_closed(tiny_bundle, tmp_path):
    """The kernel sends SIGHUP, and every write to the terminal fails with EIO from then on."""
    leader, follower = pty.openpty()
    command = [*COMMAND, "run", str(tiny_bundle), "synthetic:1:2000", "--out", str(tmp_path)]
    streams = {"stdin": follower, "stdout": follower, "stderr": follower}
    process = popen(["setsid", "--ctty", "--wait", *command], **streams)
    os.close(follower)
    wait_for(lambda: lines_in(tmp_path) >= 2)
    os.close(leader)
    assert process.wait(timeout=60) == 130
    assert (tmp_path / "results.jsonl").read_bytes().endswith(b"\n")


def lines_in(out: Path) -> int:
    path = out / "results.jsonl"
    return path.read_bytes().count(b"\n") if path.exists() else 0
