"""The quantization of a bundle: what it writes, what it refuses, and blocks that stay in float32."""

import csv
import hashlib
import json
import shutil
from dataclasses import replace

import numpy as np
import onnx
import pytest

from duospacenet.data.scene_writer import write_scene
from duospacenet.export.quantization.candidate import blocks_in
from duospacenet.jobs import evaluate_bundle, inspect_bundle, quantization, quantize_bundle
from duospacenet.jobs.quantization_calibration import calibrate
from duospacenet.jobs.quantization_frames import Clip
from duospacenet.jobs.quantization_judge import Judgement
from duospacenet.runtime import Pipeline
from duospacenet.runtime.bundle.manifest import read_manifest
from duospacenet.runtime.bundle.quantization_record import MetricsRecord
from duospacenet.runtime.errors import ArtifactError, CheckError, InputError, OutputError, UsageError
from duospacenet.runtime.session import to_tensors
from duospacenet.synthetic.drive import SyntheticDrive
from tests.helpers.file_schemas import validate_bundle
from tests.helpers.quantized import CALIBRATION, JUDGING, quantize_tiny
from tests.helpers.streams import detect_all, lose_cameras


def test_the_bundle_is_complete_and_runs_like_any_other(tiny_int8_bundle, tiny_bundle):
    manifest = inspect_bundle(tiny_int8_bundle)
    assert manifest.precision == "int8"
    assert manifest.parity.passed and manifest.parity.frames == 14
    validate_bundle(tiny_int8_bundle)
    names = {path.name for path in tiny_int8_bundle.iterdir()}
    assert names == {path.name for path in tiny_bundle.iterdir()} | {"sensitivity.csv"}
    assert 0 <= evaluate_bundle(tiny_int8_bundle, JUDGING).report.mean_average_precision <= 1


def test_the_detections_agree_with_those_of_the_float32_bundle(tiny_int8_bundle, tiny_bundle, frames):
    float32 = detect_all(Pipeline.load(tiny_bundle), frames, maps=True)
    int8 = detect_all(Pipeline.load(tiny_int8_bundle), frames, maps=True)
    for expected, got in zip(float32, int8, strict=True):
        order = np.lexsort((np.array(expected.classes), expected.queries))
        other = np.lexsort((np.array(got.classes), got.queries))
        assert np.abs(expected.scores[order] - got.scores[other]).mean() < 0.02
        assert 0 < np.abs(expected.boxes[order] - got.boxes[other])[:, :3].mean() < 0.1
        for name, mask in expected.maps.items():
            assert 0 < np.abs(mask - got.maps[name]).mean() < 0.03


def test_the_record_names_the_float32_bundle_and_all_frames(tiny_int8_bundle, tiny_bundle):
    record = read_manifest(tiny_int8_bundle).quantization
    digest = hashlib.sha256((tiny_bundle / "manifest.json").read_bytes()).hexdigest()
    assert record.float_manifest_sha256 == digest
    assert (record.calibration.sources, record.calibration.frames) == ((CALIBRATION,), 3)
    assert (record.judging.sources, record.judging.frames) == ((JUDGING,), 1)
    assert record.metrics is None
    assert record.agreement.engine.matched > 0.9
    assert record.float_blocks == ()
    assert {"image_encoder.neck", "divergence_enhancement.conv3d", "segmentation.up"} < set(record.quantized_blocks)


def test_graphs_of_positions_stay_as_they_are(tiny_int8_bundle, tiny_bundle):
    for name in ("projector.onnx", "decoder.onnx"):
        assert (tiny_int8_bundle / name).read_bytes() == (tiny_bundle / name).read_bytes()
    for name in ("backbone.onnx", "lifter.onnx", "segmenter.onnx"):
        assert "QuantizeLinear" in {node.op_type for node in onnx.load(tiny_int8_bundle / name).graph.node}


def test_the_sensitivity_of_every_block_is_listed_most_sensitive_first(tiny_int8_bundle):
    with (tiny_int8_bundle / "sensitivity.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {row["block"] for row in rows} == set(read_manifest(tiny_int8_bundle).quantization.quantized_blocks)
    errors = [float(row["error"]) for row in rows]
    assert errors == sorted(errors, reverse=True) and errors[-1] > 0
    assert {row["precision"] for row in rows} == {"int8"}
    # A block of the segmenter changes no box.
    of_segmenter = [row for row in rows if row["graph"] == "segmenter"]
    assert {(float(row["score_error"]), float(row["position_error_m"])) for row in of_segmenter} == {(0.0, 0.0)}
    assert all(float(row["map_error"]) > 0 for row in of_segmenter)


# --- What is refused ----------------------------------------------------------------------------------------------


def test_an_int8_bundle_is_not_quantized_again(tiny_int8_bundle, tmp_path):
    with pytest.raises(ArtifactError, match="field precision: expected a float32 bundle; got int8"):
        quantize_tiny(tiny_int8_bundle, tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_an_existing_folder_is_not_touched(tiny_bundle, tmp_path):
    (tmp_path / "mine").write_text("mine")
    with pytest.raises(OutputError, match="expected a new folder"):
        quantize_tiny(tiny_bundle, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]


def test_a_source_without_boxes_is_refused_with_the_advice(tiny_bundle, tmp_path):
    write_scene(tmp_path / "scene", SyntheticDrive(1, frames=2))
    scene = json.loads((tmp_path / "scene/scene.json").read_text())
    for frame in scene["frames"]:
        frame.pop("boxes", None)
    (tmp_path / "scene/scene.json").write_text(json.dumps(scene))
    with pytest.raises(InputError, match=r"expected true boxes .*--no-metrics"):
        quantize_tiny(tiny_bundle, tmp_path / "out", eval_sources=[tmp_path / "scene"], metrics=True)
    assert not (tmp_path / "out").exists()


def test_the_same_frames_twice_are_refused(tiny_bundle, tmp_path):
    with pytest.raises(UsageError, match="--eval-source: expected other sources"):
        quantize_tiny(tiny_bundle, tmp_path / "out", eval_sources=[CALIBRATION])


def test_a_damaged_bundle_is_refused(copied_bundle, tmp_path):
    shutil.copy(copied_bundle / "lifter.onnx", copied_bundle / "backbone.onnx")
    with pytest.raises(ArtifactError, match="backbone"):
        quantize_tiny(copied_bundle, tmp_path / "out")
    assert [path.name for path in tmp_path.iterdir() if path != copied_bundle] == []


def test_frames_without_any_image_cannot_calibrate(tiny_bundle, tmp_path):
    write_scene(tmp_path / "dark", [lose_cameras(frame, *frame.cameras) for frame in SyntheticDrive(1, frames=2)])
    with pytest.raises(InputError, match="--source: expected a frame with an image"):
        quantize_bundle(tiny_bundle, tmp_path / "dark", tmp_path / "out", eval_sources=[JUDGING], metrics=False)
    assert not (tmp_path / "out").exists()


class BrightFrames:
    """A drive whose darkest pixel has the value 128."""

    identity = "bright"

    def __init__(self):
        self.drive = SyntheticDrive(1, frames=2)

    def frame(self, index):
        frame = self.drive.frame(index)
        return replace(frame, images={name: image // 2 + 128 for name, image in frame.images.items()})


def test_the_image_of_a_lost_camera_is_in_the_calibrated_range(tiny_bundle, tmp_path):
    """It is black. The frames of the calibration may all be brighter."""
    pipeline = Pipeline.load(tiny_bundle)
    candidates = calibrate(tiny_bundle, pipeline, [Clip(BrightFrames(), 0, 2)], tmp_path)
    blocks = [block for block in blocks_in(tiny_bundle, pipeline.manifest) if block.graph == "backbone"]
    int8 = candidates.engine_pipeline(candidates.quantize(blocks))
    (spec,) = pipeline.manifest.graphs["backbone"].inputs
    black = to_tensors(**{spec.name: np.zeros(spec.shape, np.uint8)})
    expected, features = (each.sessions["backbone"].run(black) for each in (pipeline, int8))
    for name, value in expected.items():
        difference, rms = features[name].numpy() - value.numpy(), np.sqrt(np.mean(value.numpy() ** 2))
        assert np.sqrt(np.mean(difference**2)) < 0.3 * rms, name


@pytest.mark.parametrize("option", ["limit", "calibration_frames"])
def test_a_number_of_frames_below_one_is_refused(tiny_bundle, tmp_path, option):
    with pytest.raises(UsageError, match=f"--{option.replace('_', '-')}: expected at least 1; got 0"):
        quantize_tiny(tiny_bundle, tmp_path / "out", **{option: 0})


# --- The gate -----------------------------------------------------------------------------------------------------


@pytest.fixture
def judged(monkeypatch):
    """Given pairs of mAP and IoU instead of runs: of float32, of each choice of blocks, and of the simulation."""
    results: list[tuple[float, float]] = []
    labels: list[str] = []

    def judge(pipeline, clips, with_metrics, progress, label):
        labels.append(label)
        mAP, iou = results.pop(0)
        return Judgement([], MetricsRecord(mAP=mAP, NDS=0.5, map_iou={"drivable_area": iou}))

    monkeypatch.setattr(quantization, "judge", judge)
    monkeypatch.setattr(quantization, "SENSITIVITY_FRAMES", 1)
    return results, labels


@pytest.fixture
def no_parity_check(tiny_int8_bundle, monkeypatch):
    """The report of another int8 bundle, to save time."""
    report = read_manifest(tiny_int8_bundle).parity
    monkeypatch.setattr(quantization._Quantization, "_check_parity", lambda job: report)


@pytest.mark.usefixtures("no_parity_check")
def test_the_most_sensitive_blocks_stay_in_float32_until_the_metrics_hold(tiny_bundle, tmp_path, judged):
    results, labels = judged
    results += [(0.8, 0.9), (0.7, 0.9), (0.79, 0.8), (0.799, 0.9), (0.799, 0.9)]
    messages: list[str] = []
    quantized = quantize_tiny(tiny_bundle, tmp_path / "out", metrics=True, notify=messages.append)
    with (tmp_path / "out/sensitivity.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["precision"] for row in rows] == ["float32"] * 2 + ["int8"] * (len(rows) - 2)
    assert set(quantized.record.float_blocks) == {row["block"] for row in rows[:2]}
    assert messages == [
        f"mAP: expected a loss of at most 0.005; got 0.1000; {rows[0]['block']} stays in float32",
        f"mAP: expected a loss of at most 0.005; got 0.0100; {rows[1]['block']} stays in float32",
    ]
    assert labels[0] == "float32" and labels[-1] == "int8, simulated"
    assert quantized.record.metrics.float32.mAP == 0.8


@pytest.mark.usefixtures("no_parity_check")
def test_if_only_a_map_is_wrong_the_most_sensitive_block_of_maps_stays_in_float32(tiny_bundle, tmp_path, judged):
    results, _ = judged
    results += [(0.8, 0.9), (0.8, 0.8), (0.8, 0.9), (0.8, 0.9)]
    quantized = quantize_tiny(tiny_bundle, tmp_path / "out", metrics=True)
    with (tmp_path / "out/sensitivity.csv").open() as file:
        worst = max(csv.DictReader(file), key=lambda row: float(row["map_error"]))
    assert quantized.record.float_blocks == (worst["block"],)


def test_a_bundle_whose_metrics_never_hold_is_not_written(tiny_bundle, tmp_path, judged):
    results, labels = judged
    results += [(0.8, 0.9)] + [(0.5, 0.9)] * 100
    with pytest.raises(CheckError, match="loses too much with every choice of blocks; no bundle was written"):
        quantize_tiny(tiny_bundle, tmp_path / "out", metrics=True)
    assert list(tmp_path.iterdir()) == []
    assert labels[-1] == "int8, 1 blocks"


def test_a_bundle_that_differs_too_much_is_not_written(tiny_bundle, tmp_path, judged, monkeypatch):
    from duospacenet.runtime.parity import tolerances

    results, _ = judged
    results += [(0.8, 0.9)] * 3
    strict = tolerances.INT8_TOLERANCES.model_copy(update={"graph": 1e-3})
    monkeypatch.setattr(tolerances, "INT8_TOLERANCES", strict)
    with pytest.raises(CheckError, match=r"no bundle was written:\n  backbone\.\w+, frame \d+: RMS error"):
        quantize_tiny(tiny_bundle, tmp_path / "out", metrics=True)
    assert list(tmp_path.iterdir()) == []


def test_an_interruption_leaves_nothing_behind(tiny_bundle, tmp_path):
    def interrupt(items, label, **_):
        for item in items:
            if label == "sensitivity":
                raise KeyboardInterrupt
            yield item

    with pytest.raises(KeyboardInterrupt):
        quantize_tiny(tiny_bundle, tmp_path / "out", progress=interrupt)
    assert list(tmp_path.iterdir()) == []
