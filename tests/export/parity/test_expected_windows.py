"""The windows that the reset rules give for the stress sequence."""

import numpy as np
import pytest

from duospacenet.export.parity.expected_windows import expected_windows
from duospacenet.export.parity.stress_sequence import stress_sequence
from duospacenet.model import PRESETS
from duospacenet.runtime import Frame
from duospacenet.runtime.geometry import rigid_transform, rotation_from_quaternion, rotation_z
from duospacenet.weights.input_contract import temporal_window

LIMITS = temporal_window(PRESETS["tiny"])


def test_windows_fill_and_slide_skip_a_frame_without_images_and_end_at_every_reset():
    windows = expected_windows(stress_sequence(PRESETS["tiny"]), LIMITS)
    assert [len(window) for window in windows] == [1, 2, 3, 4, 4, 0, 4, 4, 4, 1, 2, 1, 1, 1]
    assert windows[4] == [4, 3, 2, 1]
    assert windows[6] == [6, 4, 3, 2]
    assert windows[10] == [10, 9]


def test_a_first_frame_without_images_is_skipped():
    frames = stress_sequence(PRESETS["tiny"])[5:8]
    assert expected_windows(frames, LIMITS) == [[], [1], [2, 1]]


@pytest.mark.parametrize("step_s", [0.1, 0.25, 0.5, 0.9])
def test_a_turn_of_more_than_180_degrees_per_second_ends_the_window(step_s):
    """The turn is about a tilted axis, and just below or above the limit."""
    tilt = rigid_transform(rotation_from_quaternion(np.array([0.8, 0.0, 0.6, 0.0])), [0.0, 0.0, 0.0])
    for excess_deg, windows in ((-1.0, [[0], [1, 0]]), (1.0, [[0], [1]])):
        turn = rigid_transform(rotation_z(np.radians(180 * step_s + excess_deg)), [0.0, 0.0, 0.0])
        poses = (tilt, tilt @ turn)
        frames = [Frame({}, {}, pose, 10.0 + step_s * number, "s") for number, pose in enumerate(poses)]
        assert expected_windows(frames, LIMITS) == windows
