"""Inference as a function: it writes the same files as the command, and prints nothing."""

import json

import numpy as np
import pytest

from duospacenet import jobs
from duospacenet.cli.main import run_app
from duospacenet.data.results import read_results
from duospacenet.runtime.errors import UsageError
from duospacenet.synthetic.drive import SyntheticDrive
from tests.helpers.output_files import contents
from tests.helpers.scene_files import write_jpeg_scene

DRIVE = "synthetic:5:3"
MEASURED = {"out", "median_ms", "peak_memory_gb"}  # these differ between two runs


def test_the_job_writes_the_same_bytes_and_returns_the_same_summary_as_the_command(tiny_bundle, tmp_path, capfd):
    options = ["--draw-ground-truth", "--video", "--maps", "--format", "jsonl, nuscenes", "--min-score", "0.5"]
    assert run_app(["run", str(tiny_bundle), DRIVE, "--out", str(tmp_path / "command"), *options, "--json"]) == 0
    printed = json.loads(capfd.readouterr().out)
    summary = jobs.run(
        tiny_bundle,
        DRIVE,
        tmp_path / "job",
        draw_ground_truth=True,
        video=True,
        maps=True,
        formats=("jsonl", "nuscenes"),
        min_score=0.5,
    )
    printed_by_job = capfd.readouterr()
    assert printed_by_job.out == printed_by_job.err == ""
    written = contents(tmp_path / "job")
    assert written == contents(tmp_path / "command")
    assert {"run.json", "results.jsonl", "results_nusc.json", "video.mp4", "pictures/000002.png"} <= written.keys()
    returned = summary.to_dict()
    assert returned.keys() == printed.keys()
    assert {name: returned[name] for name in returned.keys() - MEASURED} == {
        name: printed[name] for name in printed.keys() - MEASURED
    }
    assert returned["median_ms"].keys() == printed["median_ms"].keys()


def test_a_run_without_pictures_and_maps_leaves_no_empty_folders(tiny_bundle, tmp_path):
    jobs.run(tiny_bundle, DRIVE, tmp_path / "out")
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["results.jsonl", "run.json"]


def test_the_job_resumes_a_run_that_the_command_began(tiny_bundle, tmp_path):
    assert run_app(["run", str(tiny_bundle), DRIVE, "--out", str(tmp_path)]) == 0
    whole = contents(tmp_path)
    lines = whole["results.jsonl"].splitlines(keepends=True)
    (tmp_path / "results.jsonl").write_bytes(lines[0])
    assert jobs.run(tiny_bundle, DRIVE, tmp_path, resume=True).frames == 3
    assert contents(tmp_path) == whole


def test_frames_pass_through_the_progress_callback(tiny_bundle, tmp_path):
    seen = []

    def record(items, description, total=None, *, done=0, label=None):
        for number, item in enumerate(items, start=done):
            seen.append((description, item, number, label(item)))
            yield item

    jobs.run(tiny_bundle, DRIVE, tmp_path, progress=record)
    label = "scene 1 of 1, synthetic-5"
    assert seen == [("run", 0, 0, label), ("run", 1, 1, label), ("run", 2, 2, label)]
    lines = (tmp_path / "results.jsonl").read_bytes().splitlines(keepends=True)
    (tmp_path / "results.jsonl").write_bytes(b"".join(lines[:2]))
    jobs.run(tiny_bundle, DRIVE, tmp_path, progress=record, resume=True)
    assert seen[3:] == [("run", 2, 2, label)]


def test_a_single_format_may_be_given_as_text(tiny_bundle, tmp_path):
    jobs.run(tiny_bundle, DRIVE, tmp_path, formats="nuscenes")
    assert (tmp_path / "results_nusc.json").exists()


def test_an_unknown_format_is_refused_before_anything_is_written(tiny_bundle, tmp_path):
    with pytest.raises(UsageError, match="expected jsonl or nuscenes; got 'xml'"):
        jobs.run(tiny_bundle, DRIVE, tmp_path / "out", formats=["xml"])
    assert not (tmp_path / "out").exists()


def test_fast_decoding_gives_nearly_the_same_boxes_and_cannot_be_changed_when_a_run_is_resumed(tiny_bundle, tmp_path):
    scene = write_jpeg_scene(tmp_path / "scene", SyntheticDrive(5, 2, (320, 128)))
    for name, fast_decoding in (("whole", False), ("fast", True)):
        jobs.run(tiny_bundle, scene, tmp_path / name, fast_decoding=fast_decoding)
    (whole, *_), (fast, *_) = (list(read_results(tmp_path / name / "results.jsonl")) for name in ("whole", "fast"))
    assert whole["boxes"] != fast["boxes"]
    scores = [[box["score"] for box in frame["boxes"]] for frame in (whole, fast)]
    np.testing.assert_allclose(*scores, atol=0.02)
    with pytest.raises(UsageError, match="the run began with fast_decoding"):
        jobs.run(tiny_bundle, scene, tmp_path / "fast", resume=True)
