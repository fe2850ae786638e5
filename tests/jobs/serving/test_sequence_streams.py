"""Streams by sequence: starts, ends, lost sequences, and the number of streams in memory."""

import pytest

from duospacenet.jobs.serving.sequence_streams import SequenceStreams
from duospacenet.runtime.errors import InputError


class Clock:
    """A clock that is set by hand [s]."""

    def __init__(self):
        self.now_s = 0.0

    def __call__(self):
        return self.now_s


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def sequences(clock):
    return SequenceStreams(object, max_sequences=2, idle_s=10.0, clock=clock)


def request(sequences, sequence, starts=False, ends=False):
    with sequences.stream_of(sequence, starts, ends) as stream:
        return stream


def test_a_sequence_keeps_its_stream_from_start_to_end(sequences):
    first = request(sequences, "a", starts=True)
    other = request(sequences, "b", starts=True)
    assert request(sequences, "a") is first
    assert request(sequences, "b") is other is not first
    assert request(sequences, "a", ends=True) is first
    assert len(sequences) == 1
    with pytest.raises(InputError, match="sequence 'a': expected a sequence in progress; it has not started"):
        request(sequences, "a")


def test_a_start_in_the_middle_opens_a_new_stream(sequences):
    first = request(sequences, "a", starts=True)
    second = request(sequences, "a", starts=True)
    assert second is not first
    assert request(sequences, "a") is second
    assert len(sequences) == 1


def test_a_number_and_a_text_are_two_sequences(sequences):
    assert request(sequences, 7, starts=True) is not request(sequences, "7", starts=True)
    assert len(sequences) == 2


def test_a_request_that_fails_keeps_its_sequence_and_an_end_that_fails_ends_it(sequences):
    with pytest.raises(KeyError), sequences.stream_of("a", True, False) as first:
        raise KeyError
    assert request(sequences, "a") is first
    with pytest.raises(KeyError), sequences.stream_of("a", False, True):
        raise KeyError
    assert len(sequences) == 0


def test_a_start_takes_the_place_of_the_sequence_that_was_used_longest_ago(sequences):
    request(sequences, "lost", starts=True)
    kept = request(sequences, "kept", starts=True)
    request(sequences, "new", starts=True)
    assert len(sequences) == 2
    assert request(sequences, "kept") is kept
    with pytest.raises(InputError, match=r"was lost\. Send the frame again with the start flag"):
        request(sequences, "lost")


def test_a_sequence_that_starts_again_takes_its_own_place(sequences):
    kept = request(sequences, "kept", starts=True)
    request(sequences, "again", starts=True)
    request(sequences, "again", starts=True)
    assert request(sequences, "kept") is kept


def test_there_is_room_before_a_stream_is_opened(clock):
    alive = []
    sequences = SequenceStreams(lambda: alive.append(len(sequences)), max_sequences=2, idle_s=1.0, clock=clock)
    for name in "abcd":
        request(sequences, name, starts=True)
    assert alive == [0, 1, 1, 1]


def test_a_lost_sequence_is_freed_by_the_first_request_after_two_idle_times(sequences, clock):
    request(sequences, "lost", starts=True)
    request(sequences, "kept", starts=True)
    clock.now_s = 19.9
    kept = request(sequences, "kept")
    assert len(sequences) == 2
    clock.now_s = 20.1
    assert request(sequences, "kept") is kept
    assert len(sequences) == 1


def test_a_request_that_has_waited_for_long_still_finds_its_own_stream(sequences, clock):
    stream = request(sequences, "a", starts=True)
    clock.now_s = 1000.0
    assert request(sequences, "a") is stream
