"""Memory over a long drive, row P3, and the drive itself; `make soak` is the long one."""

import subprocess
import sys

import pytest

from benchmarks import soak


def run(bundle, *options) -> subprocess.CompletedProcess:
    """A soak in a process of its own. It ends with 1 where memory grows, or an answer differs.

    The row's bound of 0.5 KB a frame is `make soak`'s, whose streams have a thread each: over so few frames the growth
    of an arena weighs more, and four frames that happen to be under way at once may come late.
    """
    command = [sys.executable, soak.__file__, "--bundle", str(bundle), "--frames", "800", "--in-turn"]
    command += ["--largest-slope-kb", "4"]
    command += options
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def done(tiny_bundle):
    return run(tiny_bundle)


def test_p3_memory_does_not_grow_with_the_frames(done):
    assert done.returncode == 0, done.stdout + done.stderr


def test_p3_a_control_that_leaks_is_found(tiny_bundle):
    leaking = run(tiny_bundle, "--leak-bytes", "12000")
    assert leaking.returncode == 1, leaking.stdout + leaking.stderr
    assert " 0 differ" in leaking.stdout


def test_s5_a_long_drive_of_four_streams_answers_as_fresh_streams_do(done):
    assert "800 frames in 4 streams" in done.stdout
    assert " 0 differ" in done.stdout
    assert " 0 compared" not in done.stdout
    for event in soak.EVENTS:
        assert event in done.stdout
    for reason in ("new", "gap", "ego"):
        assert f"reset by {reason}" in done.stdout
