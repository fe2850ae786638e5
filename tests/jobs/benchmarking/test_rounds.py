"""The order of the rounds, and the ratios of hand-made rounds."""

import pytest

from duospacenet.jobs.benchmarking.rounds import Turn, cold_start, ratio_of_rounds, run_round
from duospacenet.jobs.benchmarking.samples import FRAME


class FakeWorker:
    """Answers with prepared durations of frames [s], and writes its calls to a shared log."""

    def __init__(self, name, log, frame_s=0.1, first_s=0.08):
        self.name, self.log, self.frame_s, self.first_s = name, log, frame_s, first_s

    def call(self, method, **arguments):
        self.log.append((self.name, method, *arguments.values()))
        if method == "measure_first_frame":
            return self.first_s
        return [{FRAME: self.frame_s}] * arguments["count"]


class BrokenWorker(FakeWorker):
    def call(self, method, **arguments):
        raise RuntimeError("ended")


def test_every_round_runs_every_target_and_begins_with_another_one():
    log = []
    turns = [Turn(FakeWorker(name, log), frames) for name, frames in (("a", 5), ("b", 1), ("c", 1))]
    for number in range(4):
        run_round(turns, number)
    order = [name for name, *_ in log]
    assert [order[i : i + 3] for i in range(0, 12, 3)] == [
        ["a", "b", "c"],
        ["b", "c", "a"],
        ["c", "a", "b"],
        ["a", "b", "c"],
    ]
    assert set(log) == {("a", "measure", 5), ("b", "measure", 1), ("c", "measure", 1)}
    assert [len(turn.samples) for turn in turns] == [20, 4, 4]


def test_the_cold_start_is_measured_after_the_full_window_of_the_same_round():
    log = []
    turn = Turn(FakeWorker("bundle", log, frame_s=0.12, first_s=0.1), 2, measures_cold_start=True)
    run_round([turn], 0)
    assert log == [("bundle", "measure", 2), ("bundle", "measure_first_frame")]
    record = cold_start(turn, window=4)
    assert (record.first_frame_ms, record.full_window_ms, record.ratio) == (100.0, 120.0, 1.2)


def test_a_round_that_fails_adds_no_samples():
    turns = [Turn(FakeWorker("a", []), 1, measures_cold_start=True), Turn(BrokenWorker("b", []), 1)]
    with pytest.raises(RuntimeError):
        run_round(turns, 0)
    assert [len(turn.samples) for turn in turns] == [0, 0]
    assert turns[0].first_frames_s == []


def test_a_ratio_is_the_median_of_the_rounds_ratios():
    """The machine is half as fast in rounds 1 and 3. The ratio of the two medians would be 30 / 4 = 7.5."""
    bundle, alternative = [2.0, 4.0, 2.0, 4.0, 4.0], [10.0, 20.0, 30.0, 40.0, 60.0]
    record = ratio_of_rounds(alternative, bundle)  # 5, 5, 15, 10, 15
    assert (record.q1, record.median, record.q3) == (5.0, 10.0, 15.0)


def test_a_round_that_only_one_of_them_has_is_left_out():
    """An interruption can fall between the two."""
    assert ratio_of_rounds([4.0], [2.0, 1.0]).median == 2.0
    turn = Turn(FakeWorker("bundle", []), 1, first_frames_s=[0.1, 0.2])
    turn.samples.add_round([{FRAME: 0.3}])
    assert cold_start(turn, window=4).ratio == 3.0
