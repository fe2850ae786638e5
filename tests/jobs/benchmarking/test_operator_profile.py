"""The profile of operators: sums of hand-made events, and a profile of a real bundle."""

import onnx
import pytest

from duospacenet.jobs.benchmarking.frame_cycle import FrameCycle
from duospacenet.jobs.benchmarking.operator_profile import profile_operators, skip_runs, sum_by_operator
from duospacenet.runtime.cores import available_cores


def node(operator, duration_us, start_us=0):
    return {
        "cat": "Node",
        "name": f"/{operator}_kernel_time",
        "args": {"op_name": operator},
        "dur": duration_us,
        "ts": start_us,
    }


def run(start_us, duration_us):
    return {"cat": "Session", "name": "model_run", "args": {}, "dur": duration_us, "ts": start_us}


def test_durations_are_summed_by_graph_and_operator():
    events = {
        "backbone": [node("Conv", 3000), node("Conv", 5000), node("Relu", 1000), run(0, 10000)],
        "decoder": [node("Conv", 1000), {**node("Conv", 7000), "name": "/Conv_fence_before"}],
    }
    records = sum_by_operator(events, num_frames=2)
    assert [(r.graph, r.operator, r.calls_per_frame, r.ms_per_frame, r.share) for r in records] == [
        ("backbone", "Conv", 1.0, 4.0, 0.8),
        ("backbone", "Relu", 0.5, 0.5, 0.1),
        ("decoder", "Conv", 0.5, 0.5, 0.1),
    ]


def test_the_runs_of_the_warm_up_are_left_out():
    events = [node("Conv", 5, 1), run(0, 10), node("Conv", 5, 21), run(20, 10), node("Conv", 5, 41), run(40, 10)]
    assert [event["ts"] for event in skip_runs(events, 2) if event["cat"] == "Node"] == [41]
    assert skip_runs(events, 0) == events


def test_a_profile_counts_the_nodes_of_the_graphs(tiny_bundle, pipeline, frames):
    """onnxruntime's fusions change the kinds of the segmenter's convolutions, but not their number."""
    # The pipeline has set the size of this process's thread pool to the available cores.
    records = profile_operators(tiny_bundle, pipeline.manifest, available_cores(), FrameCycle(frames, 0.5), count=2)
    profiled = sum(r.calls_per_frame for r in records if r.graph == "segmenter" and r.operator.endswith("Conv"))
    graph = onnx.load(tiny_bundle / "segmenter.onnx").graph
    assert profiled == sum(each.op_type == "Conv" for each in graph.node) > 0
    assert sum(record.share for record in records) == pytest.approx(1.0, abs=0.01)
    assert {record.graph for record in records} >= {"backbone", "lifter", "decoder", "segmenter"}
    assert [r.ms_per_frame for r in records] == sorted((r.ms_per_frame for r in records), reverse=True)
