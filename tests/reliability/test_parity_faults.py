"""RELIABILITY, rows A10 and T6: what a proof must not let pass."""

from duospacenet.export import check_parity
from duospacenet.export.parity.check import BOX_TOLERANCE, SCORE_TOLERANCE
from tests.faults.bench import Bench
from tests.faults.bundle_faults import time_folded
from tests.faults.catalogue import LATE_FRAMES, ONE_FRAME
from tests.faults.stream_faults import rgb_for_bgr


def test_a10_a_graph_that_ignores_an_input_fails_parity(tiny_bundle, tiny_model, tmp_path):
    with Bench(tiny_bundle, tiny_model, tmp_path) as bench:
        bench.edit_graph("decoder", time_folded)
        report = check_parity(bench.bundle, tiny_model, LATE_FRAMES[:1])
    assert report.dead_inputs == ["decoder.time_delta_s"]
    assert report.failures == ["decoder.time_delta_s: no output depends on this input"]
    assert not report.passed


def test_t6_rgb_for_bgr_fails_parity_by_far(tiny_bundle, tiny_model, tmp_path):
    with Bench(tiny_bundle, tiny_model, tmp_path) as bench:
        bench.feed(rgb_for_bgr)
        report = check_parity(bench.bundle, tiny_model, ONE_FRAME)
    assert report.failing_frames == [0]
    assert not report.failing_outputs
    assert report.stream[0].box > 10 * BOX_TOLERANCE
    assert report.stream[0].score > 10 * SCORE_TOLERANCE
