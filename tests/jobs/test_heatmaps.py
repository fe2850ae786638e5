"""Heatmaps of a run: the features of the right frame and cameras, without a change of the results."""

import cv2
import numpy as np
import pytest

from duospacenet import jobs
from duospacenet.jobs.heatmaps import HeatmapRecorder, pv_tensor
from duospacenet.runtime import Pipeline
from duospacenet.runtime.camera_groups import CameraGroups
from duospacenet.runtime.preprocessing import prepare
from duospacenet.runtime.session import to_tensors
from tests.helpers.output_files import contents
from tests.helpers.streams import bitwise_equal, detect_all, lose_cameras

DRIVE = "synthetic:5:2"


def own_features(pipeline, frame):
    """The backbone's outputs for one frame, computed without a stream."""
    manifest = pipeline.manifest
    inputs = prepare(frame, manifest.preprocessing, manifest.num_cameras)
    outputs = pipeline.sessions["backbone"].run(to_tensors(images=inputs.images, camera_valid=inputs.camera_valid))
    return {name: value.numpy() for name, value in outputs.items()}


@pytest.mark.parametrize("fixture", ["tiny_bundle", "tiny_int8_bundle"])
def test_the_features_are_those_of_the_last_frame_by_camera(fixture, request, frames):
    pipeline = Pipeline.load(request.getfixturevalue(fixture))
    recorder = HeatmapRecorder(pipeline)
    stream = recorder.pipeline.stream()
    for frame in (frames[0], lose_cameras(frames[1], "CAM_FRONT")):
        stream.step(frame)
        recorded, expected = recorder.features(frame), own_features(pipeline, frame)["pv_value_0_0"]
        shown = [name for name in frame.cameras if frame.images[name] is not None]
        assert list(recorded.pv) == shown
        for name in shown:
            np.testing.assert_array_equal(recorded.pv[name], expected[list(frame.cameras).index(name)])
        assert recorded.bev.shape == (*pipeline.manifest.graphs["lifter"].outputs[0].shape[1:],)


def test_recording_changes_no_detection(pipeline, frames):
    recorded = detect_all(HeatmapRecorder(pipeline).pipeline, frames[:3], maps=True)
    for one, other in zip(recorded, detect_all(pipeline, frames[:3], maps=True), strict=True):
        assert bitwise_equal(one, other)


class OneCamera:
    """The session of a backbone that takes one camera, made from one that takes all."""

    precision = "float32"

    def __init__(self, session, num_cameras):
        self._session, self._num_cameras = session, num_cameras

    def run(self, tensors):
        images = np.repeat(tensors["images"].numpy(), self._num_cameras, axis=0)
        outputs = self._session.run(to_tensors(images=images))
        return {name: to_tensors(value=np.ascontiguousarray(o.numpy()[:1]))["value"] for name, o in outputs.items()}


def test_a_backbone_that_runs_camera_by_camera_gives_the_features_of_all(pipeline, frames):
    spec = pipeline.manifest.graphs["backbone"]
    single = spec.model_copy(
        update={
            "inputs": tuple(each.model_copy(update={"shape": (1, *each.shape[1:])}) for each in spec.inputs),
            "outputs": tuple(each.model_copy(update={"shape": (1, *each.shape[1:])}) for each in spec.outputs),
        }
    )
    groups = CameraGroups(OneCamera(pipeline.sessions["backbone"], 6), single, 6)
    recorder = HeatmapRecorder(pipeline.with_sessions({**pipeline.sessions, "backbone": groups}))
    recorder.pipeline.stream().step(lose_cameras(frames[0], "CAM_BACK"))
    recorded = recorder.features(lose_cameras(frames[0], "CAM_BACK"))
    expected = own_features(pipeline, frames[0])["pv_value_0_0"]
    assert len(recorded.pv) == 5
    for name, level in recorded.pv.items():
        np.testing.assert_allclose(level, expected[list(frames[0].cameras).index(name)], atol=1e-5)


def test_the_tensor_is_the_first_cached_one_or_that_for_lifting(pipeline):
    manifest = pipeline.manifest
    assert pv_tensor(manifest) == "pv_value_0_0"
    bev_only = manifest.model_copy(update={"memory": ("bev_value_0", "bev_value_1")})
    assert pv_tensor(bev_only) == manifest.graphs["backbone"].outputs[0].name == "reduced_pv_0"


def test_a_run_writes_one_picture_per_processed_frame_and_resumes(tiny_bundle, tmp_path):
    options = {"heatmaps": True, "min_score": 0.1}
    jobs.run(tiny_bundle, DRIVE, tmp_path, **options)
    whole = contents(tmp_path)
    assert {"heatmaps/000000.png", "heatmaps/000001.png"} < set(whole)
    picture = cv2.imread(str(tmp_path / "heatmaps" / "000001.png"))
    assert picture.shape[0] > 500
    lines = whole["results.jsonl"].splitlines(keepends=True)
    (tmp_path / "results.jsonl").write_bytes(lines[0])
    (tmp_path / "heatmaps" / "000001.png").unlink()
    jobs.run(tiny_bundle, DRIVE, tmp_path, resume=True, **options)
    assert contents(tmp_path) == whole
    jobs.run(tiny_bundle, DRIVE, tmp_path, overwrite=True)
    assert not (tmp_path / "heatmaps").exists()
