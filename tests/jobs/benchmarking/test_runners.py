"""Runs of single frames: what is measured, and in which state the stream is."""

import threading
import time
from itertools import islice

import pytest

from duospacenet.jobs.benchmarking.frame_cycle import FrameCycle
from duospacenet.jobs.benchmarking.runners import BundleRunner, Throughput, measure_first_frame, measure_frames
from duospacenet.runtime.errors import InputError


class FakeRunner:
    """Takes 2 ms per frame of its window."""

    window = 3

    def __init__(self):
        self.frames = 0

    def step(self, frame):
        self.frames = min(self.frames + 1, self.window)
        time.sleep(0.002 * self.frames)
        return {"backbone": 0.002, "decoder": 0.001}

    def reset(self):
        self.frames = 0


def test_every_frame_has_the_duration_of_its_stages_and_of_itself(frames):
    rows = measure_frames(FakeRunner(), FrameCycle(frames, 0.5), 4)
    assert [list(row) for row in rows] == [["backbone", "decoder", "frame"]] * 4
    assert all(row["frame"] >= 0.002 for row in rows)
    assert all(row["frame"] >= 0.006 for row in rows[2:])


def test_the_first_frame_has_a_window_of_one_and_the_window_is_filled_again(frames):
    runner = FakeRunner()
    cycle = FrameCycle(frames, 0.5)
    measure_frames(runner, cycle, 5)
    assert 0.002 <= measure_first_frame(runner, cycle) < 0.1
    assert runner.frames == 3


def test_a_bundle_runs_with_maps_and_reports_its_stages(pipeline, frames):
    rows = measure_frames(BundleRunner(pipeline), FrameCycle(frames, 0.5), 2)
    assert set(rows[1]) >= {"preprocess", "backbone", "lifter", "decoder", "segmenter", "postprocess", "frame"}
    assert sum(value for stage, value in rows[1].items() if stage != "frame") <= rows[1]["frame"]


def test_frames_that_reset_the_stream_are_refused(pipeline, frames, other_frames):
    with pytest.raises(InputError, match="expected frames that continue each other; got new scene"):
        measure_frames(BundleRunner(pipeline), iter([frames[0], other_frames[0]]), 2)


def test_streams_run_at_the_same_time_and_each_runs_a_few_frames(pipeline, frames):
    threads = set()

    class Recorder(BundleRunner):
        def open_stream(self):
            stream = super().open_stream()
            step = stream.step
            stream.step = lambda frame: (threads.add(threading.get_ident()), step(frame))[1]
            return stream

    throughput = Throughput(Recorder(pipeline), lambda: FrameCycle(frames, 0.5), min_frames=3)
    count, seconds = throughput.measure(2, duration_s=0.0)
    assert count == 6
    assert seconds > 0
    assert len(threads) == 3  # this thread fills the windows
    count, seconds = throughput.measure(1, duration_s=0.3)
    assert count >= 3
    assert seconds >= 0.3


def test_the_frames_of_two_streams_do_not_share_their_time(frames):
    one, other = FrameCycle(frames, 0.5), FrameCycle(frames, 0.5)
    list(islice(one, 3))
    assert next(other).timestamp_s == frames[0].timestamp_s
