"""Scoring: samples from a detector, and that the job gives what the command prints."""

import json

import numpy as np
import pytest

from duospacenet.cli.main import run_app
from duospacenet.evaluation import evaluate
from duospacenet.jobs import evaluate_bundle
from duospacenet.jobs.scoring import detect_samples
from duospacenet.jobs.sources import open_source
from duospacenet.runtime.detections import Detections, HistoryReport

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
            assert np.nanmax(list(one.errors.values())) < 1e-5


@pytest.mark.parametrize(
    ("single_frame", "limit", "resets", "frames"),
    [(False, None, [0, 3], 5), (True, None, [0, 1, 2, 3, 4], 5), (False, 1, [0, 1], 2), (False, 9, [0, 3], 5)],
)
def test_the_history_is_reset_before_each_source_or_before_each_frame(single_frame, limit, resets, frames):
    oracle = Oracle()
    report = evaluate(detect_samples(oracle, [open_source(spec) for spec in DRIVES], single_frame, limit))
    assert oracle.resets == resets
    assert report.num_samples == len(oracle.tokens) == frames
