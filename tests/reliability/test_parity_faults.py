"""Reliability rows A10, A11 and T6: faults that must fail the parity check."""

from duospacenet.export import check_parity
from duospacenet.runtime.parity.tolerances import BOX_TOLERANCE, SCORE_TOLERANCE
from tests.faults.bench import Bench
from tests.faults.bundle_faults import time_made_constant
from tests.faults.catalogue import LATE_FRAMES, ONE_FRAME
from tests.faults.stream_faults import rgb_for_bgr


def test_a10_a_graph_that_ignores_an_input_fails_parity(tiny_bundle, tiny_model, tmp_path):
    with Bench(tiny_bundle, tiny_model, tmp_path) as bench:
        bench.edit_graph("decoder", time_made_constant)
        result = check_parity(bench.bundle, tiny_model, stress_frames=LATE_FRAMES[:1])
    assert {"class_logits", "boxes"} == {output for graph, output, _ in result.failing_outputs if graph == "decoder"}
    assert not result.passed


def test_a11_a_manifest_with_other_classes_fails_parity(tiny_bundle, tiny_model, tmp_path):
    with Bench(tiny_bundle, tiny_model, tmp_path) as bench:
        bench.edit_manifest(lambda manifest: manifest["classes"].reverse())
        result = check_parity(bench.bundle, tiny_model, stress_frames=ONE_FRAME, random_inputs=0)
    assert [difference.field for difference in result.manifest] == ["classes"]
    assert result.failing_frames == [0]


def test_t6_rgb_for_bgr_fails_parity_with_errors_ten_times_the_tolerance(tiny_bundle, tiny_model, tmp_path):
    with Bench(tiny_bundle, tiny_model, tmp_path) as bench:
        bench.change_stream_frames(rgb_for_bgr)
        result = check_parity(bench.bundle, tiny_model, stress_frames=ONE_FRAME, random_inputs=0)
    assert result.failing_frames == [0]
    assert not result.failing_outputs
    assert result.stream[0].box > 10 * BOX_TOLERANCE
    assert result.stream[0].score > 10 * SCORE_TOLERANCE
