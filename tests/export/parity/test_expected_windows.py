"""The windows that the reset rules give for the stress sequence."""

from duospacenet.export.parity.expected_windows import expected_windows
from duospacenet.export.parity.stress_sequence import stress_sequence
from duospacenet.model import PRESETS
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
