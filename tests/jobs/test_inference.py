"""Inference as a function: it writes the same files as the command, and prints nothing."""

import json

import pytest

from duospacenet import jobs
from duospacenet.cli.main import run_app
from duospacenet.runtime.errors import UsageError
from tests.helpers.output_files import contents

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

    def record(items, description, total=None):
        for item in items:
            seen.append((description, item))
            yield item

    jobs.run(tiny_bundle, DRIVE, tmp_path, progress=record)
    assert seen == [("run", 0), ("run", 1), ("run", 2)]


def test_a_single_format_may_be_given_as_text(tiny_bundle, tmp_path):
    jobs.run(tiny_bundle, DRIVE, tmp_path, formats="nuscenes")
    assert (tmp_path / "results_nusc.json").exists()


def test_an_unknown_format_is_refused_before_anything_is_written(tiny_bundle, tmp_path):
    with pytest.raises(UsageError, match="expected jsonl or nuscenes; got 'xml'"):
        jobs.run(tiny_bundle, DRIVE, tmp_path / "out", formats=["xml"])
    assert not (tmp_path / "out").exists()
