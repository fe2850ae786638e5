"""Reliability row P3, and S5 over many frames: memory use and results of a short soak. `make soak` is longer."""

import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks import soak

ROOT = Path(soak.__file__).parent.parent


def run_soak(bundle, *options) -> subprocess.CompletedProcess:
    """Run a soak in its own process. It exits with 1 if memory grows, or if sampled detections differ.

    `make soak` limits the growth to 0.5 KB per frame. Over only 800 frames the growth of an allocator's arena weighs
    more, so the limit is 4 KB here. The streams run in turn, because four parallel frames may first occur late.
    """
    command = [sys.executable, "-m", "benchmarks.soak", "--bundle", str(bundle), "--frames", "800", "--in-turn"]
    command += ["--largest-slope-kb", "4"]
    command += options
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)


@pytest.fixture(scope="module")
def soak_process(tiny_bundle):
    return run_soak(tiny_bundle)


def test_p3_memory_does_not_grow_with_the_frames(soak_process):
    assert soak_process.returncode == 0, soak_process.stdout + soak_process.stderr


def test_p3_a_leak_is_detected(tiny_bundle):
    leaking = run_soak(tiny_bundle, "--leak-bytes", "12000")
    assert leaking.returncode == 1, leaking.stdout + leaking.stderr
    assert " 0 differ" in leaking.stdout


def test_s5_long_streams_equal_fresh_streams_over_the_window(soak_process):
    assert "800 frames in 4 streams" in soak_process.stdout
    assert " 0 differ" in soak_process.stdout
    assert " 0 compared" not in soak_process.stdout
    for event in soak.EVENTS:
        assert event in soak_process.stdout
    for reason in ("new", "gap", "ego"):
        assert f"reset by {reason}" in soak_process.stdout
