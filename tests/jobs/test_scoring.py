"""Scoring: samples from a detector, and that the job gives what the command prints."""

import json

import numpy as np
import pytest

from duospacenet.cli.main import run_app
from duospacenet.data.scene_writer import write_scene
from duospacenet.evaluation import evaluate
from duospacenet.jobs import evaluate_bundle
from duospacenet.jobs.scoring import detect_samples
from duospacenet.jobs.sources import open_source
from duospacenet.runtime import Stream
from duospacenet.runtime.detections import Detections, HistoryReport
from duospacenet.runtime.errors import InputError
from duospacenet.synthetic.drive import SyntheticDrive
from tests.helpers.scene_files import write_jpeg_scene

DRIVES = ["synthetic:5:3", "synthetic:6:2"]


def test_the_job_returns_what_the_command_prints(tiny_bundle, capfd):
    scores = evaluate_bundle(tiny_bundle, DRIVES, single_frame=True, limit=1)
    printed = capfd.readouterr()
    assert printed.out == printed.err == ""
    assert run_app(["eval", str(tiny_bundle), *DRIVES, "--single-frame", "--limit", "1", "--json"]) == 0
    assert scores.to_dict() == json.loads(capfd.readouterr().out)


def test_a_single_source_may_be_given_as_text(tiny_bundle):
    alone, listed = (evaluate_bundle(tiny_bundle, sources, limit=1) for sources in (DRIVES[0], DRIVES[:1]))
    assert alone.sources == ("synthetic:5:3",)
    assert alone.to_dict() == listed.to_dict()


class Oracle:
    """A detector that returns the ground truth, and records its resets."""

    def __init__(self) -> None:
        self.resets: list[int] = []
        self.tokens: list[str] = []

    def reset(self) -> None:
        self.resets.append(len(self.tokens))

    def step(self, frame) -> Detections:
        self.tokens.append(frame.token)
        ground_truth = frame.ground_truth
        return Detections(
            boxes=ground_truth.boxes.astype(np.float32),
            scores=np.full(len(ground_truth.boxes), 0.9, np.float32),
            classes=ground_truth.classes,
            queries=np.arange(len(ground_truth.boxes)),
            history=HistoryReport(1),
            maps={name: mask.astype(np.float32) for name, mask in ground_truth.maps.items()},
        )


def test_the_ground_truth_itself_gets_perfect_scores():
    report = evaluate(detect_samples(Oracle(), [open_source(spec) for spec in DRIVES]))
    assert {one.name: one.mean_average_precision for one in report.classes if one.num_truth} == pytest.approx(
        {one.name: 1.0 for one in report.classes if one.num_truth}
    )
    assert dict(report.map_iou) == {"drivable_area": 1, "lane_boundary": 1}
    for one in report.classes:
        if one.num_truth:
            assert np.nanmax(list(one.errors.values())) < 1e-3  # detections are rounded to 0.1 mm


@pytest.mark.parametrize(
    ("single_frame", "limit", "resets", "frames"),
    [(False, None, [0, 3], 5), (True, None, [0, 1, 2, 3, 4], 5), (False, 1, [0, 1], 2), (False, 9, [0, 3], 5)],
)
def test_the_history_is_reset_before_each_source_or_before_each_frame(single_frame, limit, resets, frames):
    oracle = Oracle()
    report = evaluate(detect_samples(oracle, [open_source(spec) for spec in DRIVES], single_frame, limit))
    assert oracle.resets == resets
    assert report.num_samples == len(oracle.tokens) == frames


def rename_boxes(folder, **names):
    """A scene folder of one rendered frame, with other class names."""
    write_scene(folder, open_source("synthetic:5:1"))
    file = folder / "scene.json"
    scene = json.loads(file.read_text())
    for box in scene["frames"][0]["boxes"]:
        box["class"] = names.get(box["class"], box["class"])
    file.write_text(json.dumps(scene))
    return folder


def test_category_names_of_nuscenes_give_the_same_scores_as_class_names(tiny_bundle, tmp_path):
    plain = evaluate_bundle(tiny_bundle, rename_boxes(tmp_path / "plain"))
    raw = evaluate_bundle(tiny_bundle, rename_boxes(tmp_path / "raw", car="vehicle.car", barrier="animal"))
    num_cars = plain.report.ground_truth.used["car"]
    assert num_cars > 0
    assert raw.report.ground_truth.mapped == {("vehicle.car", "car"): num_cars}
    assert raw.to_dict()["classes"]["car"] == plain.to_dict()["classes"]["car"]


def test_unknown_names_are_refused_before_the_bundle_is_opened(tiny_bundle, tmp_path, monkeypatch):
    folder = rename_boxes(tmp_path / "kitti", car="Car", pedestrian="Person")
    monkeypatch.setattr("duospacenet.jobs.scoring.Pipeline", None)
    with pytest.raises(InputError, match=r"scene\.json: expected .*'Car' \(\d+ boxes\).*'Person' \(\d+ boxes\)"):
        evaluate_bundle(tiny_bundle, ["synthetic:5:1", folder])


def test_fast_decoding_reads_smaller_images_and_is_recorded_in_the_scores(tiny_bundle, tmp_path, monkeypatch):
    scene = write_jpeg_scene(tmp_path / "scene", SyntheticDrive(5, 1, (320, 128)))
    widths_px = []
    step = Stream.step

    def record(stream, frame):
        widths_px.append(frame.images["CAM_FRONT"].shape[1])
        return step(stream, frame)

    monkeypatch.setattr(Stream, "step", record)
    scores = [evaluate_bundle(tiny_bundle, scene, fast_decoding=fast).to_dict() for fast in (False, True)]
    assert widths_px == [320, 160]
    assert [score["fast_decoding"] for score in scores] == [False, True]
