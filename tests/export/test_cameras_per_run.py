"""A backbone that takes one camera at a time: export, parity, the stream, and the search for a fault."""

from dataclasses import replace

import numpy as np
import pytest

from duospacenet.export import bisect_parity, check_parity, graphs
from duospacenet.export.graphs import graphs_to_export
from duospacenet.model import PRESETS, DuoSpaceNet
from duospacenet.runtime import Pipeline
from duospacenet.runtime.errors import ArtifactError
from tests.faults import bundle_faults, stream_faults
from tests.faults.bench import Bench
from tests.faults.catalogue import LOST_CAMERAS, ONE_FRAME, SEQUENCE
from tests.helpers.camera_groups import copy_with_one_camera_per_run
from tests.helpers.streams import detect_all, lose_cameras


@pytest.fixture(autouse=True, scope="module")
def one_camera_at_a_time():
    """Every image counts as large."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(graphs, "_LARGEST_IMAGE_TOGETHER_PX", 0)
        yield


@pytest.fixture(scope="module")
def bundle(tiny_bundle, tiny_model, tmp_path_factory, one_camera_at_a_time):
    return copy_with_one_camera_per_run(tiny_bundle, tiny_model, tmp_path_factory.mktemp("one_camera") / "bundle")


@pytest.fixture
def bench(bundle, tiny_model, tmp_path):
    with Bench(bundle, tiny_model, tmp_path) as bench:
        yield bench


@pytest.mark.parametrize(("size_px", "cameras"), [((512, 256), 6), ((576, 256), 1)])
def test_images_above_131072_pixels_are_encoded_one_by_one(size_px, cameras):
    image = replace(PRESETS["tiny"].image, width_px=size_px[0], height_px=size_px[1])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(graphs, "_LARGEST_IMAGE_TOGETHER_PX", 2**17)
        exported = {g.name: g for g in graphs_to_export(DuoSpaceNet(replace(PRESETS["tiny-pv"], image=image)))}
    assert exported["backbone"].inputs["images"].shape[0] == cameras
    assert exported["backbone"].outputs["pv_value_0_0"].shape[0] == cameras
    assert exported["decoder"].inputs["slot0.pv_value_0_0"].shape[0] == 6


def test_the_bundle_passes_parity_with_lost_cameras(bundle, tiny_model):
    result = check_parity(bundle, tiny_model, stress_frames=SEQUENCE[:3], random_inputs=1)
    assert result.failures == result.shortfalls
    assert result.coverage.lost_cameras[0] > 0
    assert set(result.graphs["backbone"]) == {*(f"reduced_pv_{j}" for j in range(4)), *pv_values()}


def pv_values():
    return {f"pv_value_{layer}_{level}" for layer in range(2) for level in range(4)}


def test_detections_equal_those_of_all_cameras_at_once(bundle, pipeline, frames):
    lost = [frames[0], lose_cameras(frames[1], "CAM_FRONT", "CAM_BACK"), *frames[2:4]]
    one_by_one, together = detect_all(Pipeline.load(bundle, require_parity=False), lost), detect_all(pipeline, lost)
    for one, other in zip(one_by_one, together, strict=True):
        assert list(one.queries) == list(other.queries)
        np.testing.assert_allclose(one.boxes, other.boxes, atol=1e-4)
        np.testing.assert_allclose(one.scores, other.scores, atol=1e-5)


def test_a_backbone_of_another_number_of_cameras_differs_from_the_model(tiny_bundle, tiny_model):
    """`tiny_bundle` takes all cameras at once."""
    with pytest.raises(ArtifactError, match=r"backbone\.onnx: expected the inputs and outputs of the model's backbone"):
        check_parity(tiny_bundle, tiny_model, stress_frames=ONE_FRAME)


def test_a_wrong_tensor_of_the_backbone_is_found(bench, tiny_model):
    bench.edit_graph("backbone", bundle_faults.one_weight_changed)
    bisection = bisect_parity(bench.bundle, tiny_model, stress_frames=ONE_FRAME)
    assert (bisection.kind, bisection.graph, bisection.num_off) == ("tensor", "backbone", 1)
    assert bisection.module == "image_encoder.backbone.layer2.0.bn2"


def test_skipped_features_of_a_lost_camera_are_no_difference_of_the_stream(bench, tiny_model):
    """The stream gives the decoder zeros for the lost cameras. The wrong mask is the only difference."""
    stream_faults.in_window(camera_valid=lambda valid: valid | True)(bench)
    bisection = bisect_parity(bench.bundle, tiny_model, stress_frames=LOST_CAMERAS)
    assert (bisection.kind, bisection.place) == ("stream input", "decoder.camera_valid[slot 0, camera 0 CAM_FRONT]")
    assert all(place.startswith("decoder.camera_valid[") for place in bisection.others)


def test_a_wrong_result_of_a_frame_with_lost_cameras_is_reported_as_stream_output(bench, tiny_model):
    stream_faults.class_names_shifted(bench)
    bisection = bisect_parity(bench.bundle, tiny_model, stress_frames=LOST_CAMERAS)
    assert (bisection.kind, bisection.graph) == ("stream output", "")
