"""The windows that the reset rules give for the stress sequence."""

from duospacenet.export.parity.expected_windows import expected_windows
from duospacenet.export.parity.stress_sequence import stress_sequence
from duospacenet.model import PRESETS
from duospacenet.weights.input_contract import temporal_window
from tests.helpers.streams import TINY_SIZE_PX


def test_windows_fill_and_slide_and_end_at_a_scene_cut_and_at_a_gap():
    windows = expected_windows(stress_sequence(*TINY_SIZE_PX), temporal_window(PRESETS["tiny"]))
    assert [len(window) for window in windows] == [1, 2, 3, 4, 4, 4, 4, 4, 4, 1, 2, 1]
    assert windows[6] == [6, 5, 4, 3]
    assert windows[10] == [10, 9]
