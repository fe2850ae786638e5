"""The coverage of a sequence, counted by hand."""

from dataclasses import replace

import numpy as np
import pytest

from duospacenet.export.parity.expected_windows import expected_windows
from duospacenet.export.parity.sequence_coverage import Coverage
from duospacenet.export.parity.stress_sequence import stress_sequence
from duospacenet.model import PRESETS
from duospacenet.runtime.geometry import rotation_z
from duospacenet.weights.input_contract import temporal_window
from tests.helpers.streams import lose_cameras

TINY = PRESETS["tiny"]
LIMITS = temporal_window(TINY)


def coverage_of(frames, config=TINY) -> Coverage:
    limits = temporal_window(config)
    return Coverage.of(frames, expected_windows(frames, limits), config, limits)


def test_the_stress_sequence_covers_everything():
    coverage = coverage_of(stress_sequence(TINY))
    assert coverage.shortfalls(TINY) == []
    assert (coverage.frames, coverage.skipped, coverage.dropped_frames) == (14, 1, 1)
    assert coverage.windows == {1: 5, 2: 2, 3: 1, 4: 5}
    assert coverage.lost_cameras == [6, 6, 6, 6]
    assert coverage.resets == {"new scene": 1, "gap": 1, "ego jump": 1, "ego turn": 1}


@pytest.mark.parametrize(("num_cameras", "num_frames"), [(1, 4), (5, 1), (7, 4), (12, 2), (6, 8)])
def test_the_stress_sequence_covers_other_models_too(num_cameras, num_frames):
    config = replace(TINY, num_cameras=num_cameras, num_frames=num_frames)
    assert coverage_of(stress_sequence(config), config).shortfalls(config) == []


def test_motions_are_measured_between_the_frames_of_a_window(frames):
    """The second frame is 3 m ahead and 0.5 m higher, turned by 20 degrees, then pitched by 10 degrees."""
    pitch = np.radians(10)
    about_y = np.array([[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]])
    pose = np.eye(4)
    pose[:3, :3] = rotation_z(np.radians(20)) @ about_y
    pose[:3, 3] = [3, 0, 0.5]
    moved = [replace(frames[0], global_T_ego=np.eye(4)), replace(frames[1], global_T_ego=pose)]
    motion = coverage_of(moved).motion
    expected = {"pitch_deg": 10, "roll_deg": 0, "yaw_deg": 20, "height_m": 0.5, "distance_m": np.hypot(3, 0.5)}
    assert motion == pytest.approx(expected, abs=1e-9)


SHORTFALLS = {
    "a drive in the plane": (lambda frames: frames, "the largest pitch_deg within a window is 0;"),
    "no lost camera": (lambda frames: frames, "0 of 6 cameras are lost in slot 0"),
    "a short window": (lambda frames: frames[:4], "1 frames have a full window of 4 frames; expected at least 3"),
    "one calibration": (lambda frames: frames, "the calibration does not change"),
    "no reset": (lambda frames: frames, "no ego turn resets the history"),
    "no dropped frame": (lambda frames: frames, "no frame follows a dropped frame"),
    "a camera that is only lost at the end": (
        lambda frames: [*frames[:-1], lose_cameras(frames[-1], *list(frames[-1].images)[:5])],
        "5 of 6 cameras are lost in slot 0",
    ),
}


@pytest.mark.parametrize("case", SHORTFALLS)
def test_a_plain_drive_does_not_cover(case, frames):
    change, line = SHORTFALLS[case]
    lines = coverage_of(change(frames)).shortfalls(TINY)
    assert any(line in shortfall for shortfall in lines), lines


def test_limits_that_never_fill_the_window_do_not_cover():
    frames = stress_sequence(TINY)
    limits = LIMITS.model_copy(update={"largest_speed_m_s": 0.01})
    coverage = Coverage.of(frames, expected_windows(frames, limits), TINY, limits)
    assert coverage.windows == {1: 13}
    assert any("full window" in line for line in coverage.shortfalls(TINY))
