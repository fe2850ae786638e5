"""A bisection reports the first wrong tensor of a graph, or the first wrong input of a stream."""

import json

import numpy as np
import onnx
import pytest
import torch

from duospacenet.export import bisect_parity, check_parity
from duospacenet.export.bisection import deviation
from duospacenet.export.bisection.deviation import deviations
from duospacenet.export.bisection.differences import differences
from duospacenet.export.bisection.intermediates import Intermediates
from duospacenet.export.bisection.pieces import CutGraph
from duospacenet.export.bisection.search import Bisection
from duospacenet.export.graphs import graphs_to_export
from duospacenet.export.parity.reference import EagerReference
from duospacenet.model.image_encoder import Normalisation
from duospacenet.runtime import onnxruntime_session, session
from duospacenet.runtime.bundle.manifest import GRAPH_NAMES
from tests.faults import bundle_faults, stream_faults
from tests.faults.bench import Bench, edit_weight, producer_of
from tests.faults.catalogue import LOST_CAMERAS, ONE_FRAME, SEQUENCE
from tests.faults.tensor_edits import remap

TOLERANCE = 1e-4


@pytest.fixture
def bench(tiny_bundle, tiny_model, tmp_path):
    with Bench(tiny_bundle, tiny_model, tmp_path) as bench:
        yield bench


@pytest.fixture(scope="module")
def eager_runs(tiny_bundle, tiny_model):
    """Inputs and outputs of every graph in eager mode for the third frame of the stress sequence."""
    reference = EagerReference(tiny_model)
    for window in ([0], [1, 0], [2, 1, 0]):
        runs = reference.step(SEQUENCE, window)
    return runs


@pytest.mark.parametrize("name", GRAPH_NAMES)
def test_a_correct_bundle_has_no_wrong_tensor_and_more_than_80_percent_are_compared(
    name, tiny_bundle, tiny_traces, eager_runs
):
    run, file = eager_runs[name], onnx.load(tiny_bundle / f"{name}.onnx")
    eager = Intermediates(tiny_traces[name].program, run.outputs)
    cut = CutGraph(file, eager.names)
    pieces = deviations(cut, eager, run.inputs, frame=2)
    # In eager mode, the sampling in several cameras is one operator.
    sampling = [node for piece in cut.pieces.values() if "TopK" in piece.operators for node in piece.nodes]
    num_computed = sum(len(node.output) for node in file.graph.node if node not in sampling)
    assert set(run.outputs) <= {piece.piece.tensor for piece in pieces}
    assert len(pieces) > 0.8 * num_computed
    assert max(piece.error.relative for piece in pieces) < TOLERANCE / 10
    fresh = CutGraph(tiny_traces[name].file, eager.names)
    assert not [line for tensor in cut.pieces for line in differences(cut, fresh, tensor)]


def test_an_intermediate_tensor_equals_the_output_of_its_module(tiny_model, tiny_traces, eager_runs):
    recorded = {}
    image_encoder = graphs_to_export(tiny_model)[0].model.image_encoder
    hook = image_encoder.backbone.layer2[0].register_forward_hook(
        lambda module, inputs, output: recorded.update(output=output.clone())
    )
    run = eager_runs["backbone"]
    with torch.no_grad():
        image_encoder(run.inputs["images"])
    hook.remove()
    eager = Intermediates(tiny_traces["backbone"].program, run.outputs)
    last = max(
        (name for name in eager.names if eager.origin(name).module.startswith("image_encoder.backbone.layer2.0")),
        key=lambda name: int(name.rpartition("_")[2]) if name.startswith("relu_") else -1,
    )
    assert torch.equal(torch.from_numpy(eager.values([last], run.inputs)[last]), recorded["output"])


def test_the_errors_do_not_depend_on_the_chunk_size(tiny_bundle, tiny_traces, eager_runs, monkeypatch):
    run = eager_runs["lifter"]
    eager = Intermediates(tiny_traces["lifter"].program, run.outputs)
    cut = CutGraph(onnx.load(tiny_bundle / "lifter.onnx"), eager.names)
    in_one_chunk = deviations(cut, eager, run.inputs, frame=2)
    monkeypatch.setattr(deviation, "CHUNK_BYTES", 1)
    assert deviations(cut, eager, run.inputs, frame=2) == in_one_chunk


def test_a_bundle_that_passes_parity_has_no_difference(tiny_bundle, tiny_model):
    assert bisect_parity(tiny_bundle, tiny_model, stress_frames=ONE_FRAME) == Bisection("none")


def test_a_changed_attribute_is_reported_with_its_module_and_source_line(bench, tiny_model, tiny_traces):
    bench.edit_graph("decoder", bundle_faults.softmax_over_the_queries)
    bisection = bisect_parity(bench.bundle, tiny_model, stress_frames=ONE_FRAME, traces=tiny_traces)
    assert (bisection.kind, bisection.place, bisection.operators) == ("tensor", "decoder.softmax", ("Softmax",))
    assert bisection.module == "decoder.layers.0.cross_attention.bev.attention.deformable"
    assert bisection.source.startswith("model/attention.py:")
    assert bisection.remarks == ("Softmax: attribute axis is 1; in a fresh export it is -1",)
    assert (bisection.num_off, bisection.reads) == (1, ("view_1",))
    assert bisection.error.relative > TOLERANCE


def test_a_changed_weight_is_reported_with_its_index_although_it_was_folded(bench, tiny_model, tiny_traces):
    bench.edit_graph("backbone", bundle_faults.one_weight_changed)
    bisection = bisect_parity(bench.bundle, tiny_model, stress_frames=ONE_FRAME, traces=tiny_traces)
    assert bisection.module == "image_encoder.backbone.layer2.0.bn2"
    (remark,) = bisection.remarks
    assert remark.startswith(
        "constant model.image_encoder.backbone.layer2.0.conv2.weight: 1 of 2304 numbers differ from a fresh export; "
        "the largest difference is at [3, 2, 1, 1]: "
    )
    assert bisection.num_off == 1


def test_of_two_faults_the_first_in_the_graph_is_reported_and_both_are_counted(bench, tiny_model, tiny_traces):
    bench.edit_graph("decoder", bundle_faults.yaw_negated)
    bench.edit_graph("decoder", bundle_faults.softmax_over_the_queries)
    bench.edit_graph("segmenter", bundle_faults.maps_transposed)
    bisection = bisect_parity(bench.bundle, tiny_model, stress_frames=ONE_FRAME, traces=tiny_traces)
    assert (bisection.graph, bisection.others) == ("segmenter", ("decoder.class_logits", "decoder.boxes"))
    bench.edit_graph("segmenter", bundle_faults.maps_transposed)
    bisection = bisect_parity(bench.bundle, tiny_model, stress_frames=ONE_FRAME, traces=tiny_traces)
    assert (bisection.place, bisection.num_off) == ("decoder.softmax", 2)


def test_a_nan_in_a_weight_is_reported_as_strict_json(bench, tiny_model, tiny_traces):
    bench.edit_graph("segmenter", bundle_faults.nan_in_a_weight)
    bisection = bisect_parity(bench.bundle, tiny_model, stress_frames=ONE_FRAME, traces=tiny_traces)
    assert (bisection.place, bisection.module) == ("segmenter.lane_boundary", "segmentation.heads.lane_boundary.3")
    assert bisection.remarks == (
        "constant model.segmentation.heads.lane_boundary.3.bias: 1 of 1 numbers are not finite",
    )
    assert json.loads(json.dumps(bisection.to_dict(), allow_nan=False))["error"]["relative"] is None


def test_a_constant_instead_of_an_input_is_reported(bench, tiny_model, tiny_traces):
    bench.edit_graph("decoder", bundle_faults.motion_made_constant)
    bisection = bisect_parity(bench.bundle, tiny_model, stress_frames=ONE_FRAME, traces=tiny_traces)
    assert (bisection.kind, bisection.frame, bisection.module) == ("tensor", None, "decoder")
    assert bisection.seed in range(12)
    assert bisection.remarks == ("Cast reads the constant fault.constant; in a fresh export it reads past_T_now",)


def test_an_unused_input_is_reported_with_the_node_that_should_read_it(bench, tiny_model, tiny_traces):
    bench.edit_graph("decoder", bundle_faults.slot_read_twice)
    result = check_parity(bench.bundle, tiny_model, stress_frames=ONE_FRAME, random_inputs=0)
    assert [(graph, error.seed) for graph, _, error in result.failing_outputs] == [("decoder", 0)] * 2
    bisection = bisect_parity(bench.bundle, tiny_model, result=result, stress_frames=ONE_FRAME, traces=tiny_traces)
    assert (bisection.kind, bisection.graph, bisection.seed) == ("tensor", "decoder", 0)
    assert bisection.module == "decoder.layers.0.cross_attention.pv.attention.deformable"
    assert bisection.remarks == ("Reshape reads slot1.pv_value_0_0; in a fresh export it reads slot2.pv_value_0_0",)


def test_an_ignored_flag_is_reported_as_the_element_of_an_input(bench, tiny_model, tiny_traces):
    """Slot 1 is empty in the first frame, so no output differs."""
    config = tiny_model.config
    shape = (config.num_frames, config.num_cameras)
    sources = np.arange(np.prod(shape)).reshape(shape)
    sources[1, 2] = sources.size
    bench.edit_graph("decoder", lambda graph: remap(graph, "camera_valid", shape, sources, np.array([True])))
    result = check_parity(bench.bundle, tiny_model, stress_frames=ONE_FRAME, random_inputs=0)
    bisection = bisect_parity(bench.bundle, tiny_model, result=result, stress_frames=ONE_FRAME, traces=tiny_traces)
    assert (bisection.kind, bisection.place) == ("input", "decoder.camera_valid[slot 1, camera 2]")


def test_small_errors_in_a_tensor_with_huge_values_are_found(bench, tiny_model, tiny_traces):
    """Points behind a camera have locations hundreds of images away, so half a pixel is small against the RMS."""
    bench.edit_graph("projector", bundle_faults.half_a_pixel_off)
    bisection = bisect_parity(bench.bundle, tiny_model, stress_frames=ONE_FRAME, traces=tiny_traces)
    assert (bisection.kind, bisection.place, bisection.num_off) == ("tensor", "projector.div", 0)
    assert bisection.error.relative < TOLERANCE
    assert bisection.remarks == ("computed by Div, Add; a fresh export uses Div",)


def test_small_errors_that_add_up_are_reported_as_rounding(bench, tiny_model, tiny_traces):
    """Every weight of the backbone has a small error, in the file and in the fresh export."""

    def scale(model):
        for tensor in model.graph.initializer:
            if len(tensor.dims) == 4:
                edit_weight(model, tensor.name, lambda weight: weight * (1 + 8e-6))

    bench.edit_graph("backbone", scale)
    fresh = tiny_traces["backbone"]._replace(file=onnx.load(bench.bundle / "backbone.onnx"))
    bisection = bisect_parity(
        bench.bundle, tiny_model, stress_frames=ONE_FRAME, traces=tiny_traces | {"backbone": fresh}
    )
    assert (bisection.kind, bisection.graph, bisection.num_off) == ("rounding", "backbone", 0)
    assert 1e-5 < bisection.error.relative < TOLERANCE


def test_an_error_of_the_optimised_session_alone_is_reported_as_optimiser(
    tiny_bundle, tiny_model, tiny_traces, monkeypatch
):
    run = onnxruntime_session.OnnxruntimeSession.run

    def wrong_in_the_segmenter(self, inputs):
        outputs = run(self, inputs)
        if "drivable_area" in outputs:
            outputs |= session.to_tensors(drivable_area=outputs["drivable_area"].numpy() * 1.01)
        return outputs

    monkeypatch.setattr(onnxruntime_session.OnnxruntimeSession, "run", wrong_in_the_segmenter)
    bisection = bisect_parity(tiny_bundle, tiny_model, stress_frames=ONE_FRAME, traces=tiny_traces)
    assert (bisection.kind, bisection.place, bisection.num_off) == ("optimiser", "segmenter.drivable_area", 0)


def test_a_rewrite_that_differs_from_the_model_is_reported_as_trace(tiny_bundle, tiny_model, tiny_traces, monkeypatch):
    """The model normalises the colours in another order than its rewritten copy, which is traced."""
    forward = Normalisation.forward
    monkeypatch.setattr(Normalisation, "forward", lambda self, images: forward(self, images.flip(-1)))
    bisection = bisect_parity(tiny_bundle, tiny_model, stress_frames=ONE_FRAME, traces=tiny_traces)
    assert (bisection.kind, bisection.graph) == ("trace", "backbone")


STREAM_FAULTS = {
    "RGB for BGR": (
        stream_faults.in_frames(stream_faults.rgb_for_bgr),
        1,
        (
            0,
            "backbone.images[camera 0 CAM_FRONT]",
            "it is the mirror image (last dimension reversed) of the expected value",
        ),
    ),
    "calibrations in reversed order": (
        stream_faults.in_frames(stream_faults.calibrations_mirrored),
        1,
        (0, "projector.image_T_ego[camera 0 CAM_FRONT]", "it is the expected value of image_T_ego[camera 5]"),
    ),
    "motion inverted": (
        stream_faults.in_window(past_T_now=stream_faults.inverted),
        2,
        (1, "decoder.past_T_now[slot 1]", "it is the inverse of the expected value"),
    ),
    "time negated": (
        stream_faults.in_window(time_delta_s=lambda times: -times),
        2,
        (1, "decoder.time_delta_s[slot 1]", "it is the negative of the expected value"),
    ),
    "cached values exchanged": (
        stream_faults.cached_values_of_the_wrong_slot,
        3,
        (1, "decoder.slot1.pv_value_0_0", "it is the expected value of slot2.pv_value_0_0"),
    ),
    "masks are reported first": (
        stream_faults.history_always_reset,
        2,
        (1, "decoder.frame_valid[slot 1]", "all its values are 0"),
    ),
    "a lost camera marked valid": (
        stream_faults.in_frames(stream_faults.lost_camera_as_black_image),
        0,
        (0, "projector.camera_valid[camera 0 CAM_FRONT]", None),
    ),
}


@pytest.mark.parametrize("fault", STREAM_FAULTS)
def test_a_wrong_input_of_a_stream_is_reported_with_its_slot_and_camera(fault, bench, tiny_model):
    inject, num_frames, (frame, place, remark) = STREAM_FAULTS[fault]
    inject(bench)
    frames = SEQUENCE[:num_frames] if num_frames else LOST_CAMERAS
    bisection = bisect_parity(bench.bundle, tiny_model, stress_frames=frames)
    assert (bisection.kind, bisection.frame, bisection.place) == ("stream input", frame, place)
    assert bisection.remarks == ((remark,) if remark else ())


def test_the_values_of_a_masked_slot_are_not_compared(bench, tiny_model):
    """Noise in empty slots is no error. The moved pose of slot 0 is the only difference."""
    bench.patch("_empty_memory", _noise_in_empty_slots, stream_faults.pipeline)
    assert not check_parity(bench.bundle, tiny_model, stress_frames=ONE_FRAME).failing_frames
    stream_faults.in_window(past_T_now=stream_faults.current_pose_moved)(bench)
    bisection = bisect_parity(bench.bundle, tiny_model, stress_frames=ONE_FRAME)
    assert (bisection.place, bisection.others) == ("decoder.past_T_now[slot 0]", ())


def test_correct_inputs_with_wrong_results_are_reported_as_stream_output(bench, tiny_model):
    stream_faults.class_names_shifted(bench)
    bisection = bisect_parity(bench.bundle, tiny_model, stress_frames=ONE_FRAME)
    assert (bisection.kind, bisection.graph, bisection.frame) == ("stream output", "", 0)


def test_a_replaced_node_is_reported_with_both_operators(bench, tiny_model, tiny_traces):
    def drop_a_relu(model):
        node = producer_of(model, "relu_4")
        node.op_type = "Identity"

    bench.edit_graph("segmenter", drop_a_relu)
    bisection = bisect_parity(bench.bundle, tiny_model, stress_frames=ONE_FRAME, traces=tiny_traces)
    assert (bisection.tensor, bisection.remarks) == ("relu_4", ("computed by Identity; a fresh export uses Relu",))


def test_swapped_inputs_without_names_are_reported(bench, tiny_model, tiny_traces):
    bench.edit_graph("decoder", bundle_faults.headings_exchanged)
    bisection = bisect_parity(bench.bundle, tiny_model, stress_frames=ONE_FRAME, traces=tiny_traces)
    assert bisection.tensor == "cat_2"
    assert bisection.remarks == (
        "Concat: the inputs are swapped; numbered as in a fresh export, their order is 0, 1, 3, 2, 4",
    )


def test_a_wrong_input_without_a_name_is_reported(bench, tiny_model, tiny_traces):
    def sine_twice(model):
        node = producer_of(model, "cat_2")
        node.input[3] = node.input[2]

    bench.edit_graph("decoder", sine_twice)
    bisection = bisect_parity(bench.bundle, tiny_model, stress_frames=ONE_FRAME, traces=tiny_traces)
    assert bisection.tensor == "cat_2"
    assert bisection.remarks == ("Concat reads split_split_1; in a fresh export it reads split_split_0",)


def _noise_in_empty_slots(manifest):
    specs = {tensor.name: tensor.shape for tensor in manifest.graphs["decoder"].inputs}
    noise = {name: torch.randn(specs[f"slot0.{name}"]).numpy() for name in manifest.memory}
    return session.to_tensors(**noise)
