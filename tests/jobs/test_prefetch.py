import threading

import numpy as np
import pytest

from duospacenet.jobs.prefetch import prefetch
from duospacenet.runtime import Frame
from duospacenet.runtime.errors import InputError

TIMEOUT_S = 10


class Loader:
    """Loads frames whose time stamp is their number, and records each call. Frame `damaged` raises InputError."""

    def __init__(self, damaged=None):
        self.started = [threading.Event() for _ in range(6)]
        self.threads = []
        self._damaged = damaged

    def __call__(self, number):
        self.started[number].set()
        self.threads.append(threading.current_thread())
        if number == self._damaged:
            raise InputError(f"frame {number} is damaged")
        return Frame({}, {}, np.eye(4), float(number))

    @property
    def num_started(self):
        return sum(event.is_set() for event in self.started)


def prefetch_threads():
    return [thread for thread in threading.enumerate() if thread.name.startswith("prefetch")]


def test_frames_come_in_order_from_one_other_thread():
    load = Loader()
    with prefetch(load, range(6)) as frames:
        assert [frame.timestamp_s for frame in frames] == [0, 1, 2, 3, 4, 5]
    assert len(load.threads) == 6
    assert set(load.threads) == {load.threads[0]} != {threading.main_thread()}


def test_the_next_frame_is_loaded_while_the_current_one_is_processed_and_no_further_one():
    load = Loader()
    with prefetch(load, range(6)) as frames:
        for number, _ in zip(range(5), frames, strict=False):
            assert load.started[number + 1].wait(TIMEOUT_S)
            assert load.num_started == number + 2


def test_an_error_is_raised_when_its_frame_is_requested_and_no_later_frame_is_loaded():
    load, seen = Loader(damaged=2), []

    def read_all():
        with prefetch(load, range(6)) as frames:
            for frame in frames:
                assert load.started[len(seen) + 1].wait(TIMEOUT_S)
                seen.append(frame.timestamp_s)

    with pytest.raises(InputError, match="frame 2 is damaged"):
        read_all()
    assert seen == [0, 1]
    assert load.num_started == 3
    assert prefetch_threads() == []


def test_an_error_of_the_first_frame_is_raised():
    with pytest.raises(InputError, match="frame 0 is damaged"), prefetch(Loader(damaged=0), range(6)) as frames:
        next(frames)


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError])
def test_the_thread_has_ended_after_an_interruption(error):
    load = Loader()

    def interrupted():
        with prefetch(load, range(6)) as frames:
            next(frames)
            assert prefetch_threads() != []
            raise error

    with pytest.raises(error):
        interrupted()
    assert prefetch_threads() == []
    assert load.num_started <= 2


def test_no_frames_need_no_thread():
    with prefetch(Loader(), range(0)) as frames:
        assert list(frames) == []
        assert prefetch_threads() == []


def test_items_may_be_of_any_kind():
    load = Loader()
    with prefetch(lambda item: load(item[1]), [("a", 3), ("b", 1)]) as frames:
        assert [frame.timestamp_s for frame in frames] == [3, 1]
