"""Calibration: the ranges of all runs, whatever their number, and all runs of a graph within a frame."""

import numpy as np
import onnxruntime as ort
import pytest

from duospacenet.export.quantization.calibration import GraphCalibration, calibrating_pipeline
from duospacenet.runtime import Pipeline
from duospacenet.runtime.cores import available_cores
from duospacenet.runtime.onnxruntime_session import set_thread_pool_size
from duospacenet.runtime.session import to_tensors
from tests.helpers.small_graphs import FIRST, convolve, small_inputs, small_weights, write_small_graph


@pytest.fixture(autouse=True)
def thread_pool():
    set_thread_pool_size(available_cores())


def range_of(calibration: GraphCalibration, tensor: str) -> tuple[float, float]:
    low, high = calibration.ranges()[tensor].range_value
    return float(np.ravel(low)[0]), float(np.ravel(high)[0])


def test_the_ranges_cover_every_run(tmp_path):
    graph, folder = write_small_graph(tmp_path), tmp_path / "temporary"
    folder.mkdir()
    calibration, runs, weights = GraphCalibration(graph, folder), small_inputs(1, 5), small_weights()
    for inputs in runs:
        calibration.add(inputs)
    convolved = [convolve(inputs["x"], weights[f"{FIRST}.weight"], weights[f"{FIRST}.bias"]) for inputs in runs]
    values = np.concatenate([inputs["x"] for inputs in runs])
    assert range_of(calibration, "x") == pytest.approx((values.min(), values.max()))
    assert range_of(calibration, "conv") == pytest.approx((np.min(convolved), np.max(convolved)), rel=1e-5)
    assert range_of(calibration, "relu") == pytest.approx((0, np.max(convolved)), rel=1e-5)
    assert list(tmp_path.iterdir()) == [graph, folder]  # nothing is written beside the bundle's graph


def test_no_output_of_a_run_is_kept(tmp_path):
    calibration = GraphCalibration(write_small_graph(tmp_path), make(tmp_path / "temporary"))
    for inputs in small_inputs(1, 3):
        calibration.add(inputs)
    assert calibration._calibrater.intermediate_outputs == []


def test_ranges_are_copies(tmp_path):
    calibration = GraphCalibration(write_small_graph(tmp_path), make(tmp_path / "temporary"))
    calibration.add(small_inputs(1)[0])
    before = range_of(calibration, "conv")
    ranges = calibration.ranges()
    ranges["conv"] = ranges["relu"]
    assert range_of(calibration, "conv") == before


class _Calibration:
    """Counts runs and their inputs."""

    def __init__(self) -> None:
        self.shapes: list[tuple[int, ...]] = []

    def add(self, inputs) -> None:
        self.shapes.append(inputs["images"].shape)


def test_every_run_of_a_graph_is_calibrated_on(pipeline: Pipeline, frames):
    calibration = _Calibration()
    stream = calibrating_pipeline(pipeline, {"backbone": calibration}).stream()
    expected = pipeline.stream()
    for frame in frames[:2]:
        assert stream.step(frame).boxes.tobytes() == expected.step(frame).boxes.tobytes()
    spec = next(spec for spec in pipeline.manifest.graphs["backbone"].inputs if spec.name == "images")
    runs_per_frame = pipeline.manifest.num_cameras // spec.shape[0]
    assert calibration.shapes == [spec.shape] * (2 * runs_per_frame)


class _Zeros:
    """A backbone whose features are zeros."""

    precision = "float32"

    def __init__(self, spec) -> None:
        self._outputs = {tensor.name: np.zeros(tensor.shape, np.float32) for tensor in spec.outputs}

    def run(self, tensors):
        return to_tensors(**self._outputs)


def test_a_backbone_that_runs_camera_by_camera_is_calibrated_camera_by_camera(pipeline: Pipeline):
    spec = pipeline.manifest.graphs["backbone"]
    (images,) = spec.inputs
    one_camera = {
        side: tuple(each.model_copy(update={"shape": (1, *each.shape[1:])}) for each in getattr(spec, side))
        for side in ("inputs", "outputs")
    }
    spec = spec.model_copy(update=one_camera)
    manifest = pipeline.manifest.model_copy(update={"graphs": {**pipeline.manifest.graphs, "backbone": spec}})
    grouped, calibration = Pipeline(manifest, {**pipeline.sessions, "backbone": _Zeros(spec)}), _Calibration()
    session = calibrating_pipeline(grouped, {"backbone": calibration}).sessions["backbone"]
    session.run(to_tensors(images=np.zeros(images.shape, np.uint8)))
    assert calibration.shapes == [(1, *images.shape[1:])] * manifest.num_cameras


def make(folder):
    folder.mkdir()
    return folder


def test_the_calibration_shares_the_pool_of_the_process(tmp_path):
    """onnxruntime refuses a session with threads of its own once the process has a shared pool."""
    graph = write_small_graph(tmp_path)
    with pytest.raises(Exception, match="thread"):
        ort.InferenceSession(str(graph), ort.SessionOptions(), providers=["CPUExecutionProvider"])
    GraphCalibration(graph, make(tmp_path / "temporary"))
