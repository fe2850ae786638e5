"""The note about streams that are faster than the training data."""

from dataclasses import replace

import pytest

from duospacenet.jobs.frame_rate import note_fast_stream
from duospacenet.weights.input_contract import temporal_window
from tests.helpers.trainings import TINY, FixedSource, synthetic_frames

WINDOW = temporal_window(TINY)  # four frames, 0.5 s apart


def notes_about(times_s, scenes=None, window=WINDOW):
    (frame,) = synthetic_frames(1, 1)
    names = scenes or ["s"] * len(times_s)
    frames = [replace(frame, timestamp_s=time, scene=name) for time, name in zip(times_s, names, strict=True)]
    notes = []
    note_fast_stream(FixedSource(frames), window, notes.append)
    return notes


def test_a_stream_at_10_hz_is_reported_with_the_option_that_helps():
    (text,) = notes_about([10.0, 10.1, 10.2, 10.3])
    assert "the frames are 0.1 s apart, and those that the model was trained on 0.5 s" in text
    assert "--history-step 0.5 keeps" in text


@pytest.mark.parametrize("interval_s", [0.36, 0.5, 1.0])
def test_a_stream_about_as_fast_as_the_training_data_or_slower_is_not_reported(interval_s):
    assert notes_about([interval_s * index for index in range(5)]) == []


def test_times_of_different_scenes_are_not_compared():
    assert notes_about([10.0, 10.1, 10.2], ["a", "b", "c"]) == []
    assert notes_about([10.0]) == []


def test_a_window_of_one_frame_has_no_step():
    assert notes_about([10.0, 10.1, 10.2], window=WINDOW.model_copy(update={"num_frames": 1})) == []
