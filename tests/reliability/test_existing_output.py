"""Existing and unwritable output: row P6 of the reliability list."""

import shutil
from contextlib import ExitStack
from unittest import mock

import pytest

from duospacenet.cli.main import run_app
from tests.helpers.output_files import contents

DRIVE = "synthetic:5:3"


SLOW_STEPS = (
    "duospacenet.runtime.Pipeline.load",
    "duospacenet.runtime.engine.read_graphs",
    "duospacenet.synthetic.drive.SyntheticDrive.frame",
    "duospacenet.jobs.export_job.build_model",
)


def assert_refused_at_once(arguments) -> None:
    """The command ends with 5 before it loads a pipeline, reads a graph, renders a frame or builds a model.

    An AssertionError from one of these steps would end the command with another exit code.
    """
    with ExitStack() as patches:
        for name in SLOW_STEPS:
            patches.enter_context(mock.patch(name, side_effect=AssertionError(f"{name} was called")))
        assert run_app([*map(str, arguments)]) == 5


def test_p6_results_of_an_earlier_run_are_only_replaced_on_request(tiny_bundle, tmp_path, capfd):
    arguments = ["run", tiny_bundle, DRIVE, "--out", tmp_path]
    assert run_app([*map(str, arguments)]) == 0
    before = contents(tmp_path)
    assert_refused_at_once(arguments)
    assert "an earlier run wrote this file" in (message := capfd.readouterr().err)
    assert "--overwrite" in message
    assert "--resume" in message
    assert contents(tmp_path) == before
    assert run_app([*map(str, arguments), "--overwrite"]) == 0
    assert contents(tmp_path) == before


@pytest.mark.parametrize("option", ["--overwrite", "--resume"])
def test_p6_an_unwritable_folder_is_refused_at_once(tiny_bundle, tmp_path, option):
    (tmp_path / "file").write_text("mine")
    for place in ("/proc/none/out", "/dev/null/out", tmp_path / "file", tmp_path / "file" / "out"):
        assert_refused_at_once(["run", tiny_bundle, DRIVE, "--out", place])
        assert_refused_at_once(["run", tiny_bundle, DRIVE, "--out", place, option])
    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.parametrize("name", ["results.jsonl", "pictures/000000.png", "maps/000001_road.png", "video.mp4"])
def test_p6_files_that_no_run_wrote_are_never_changed(tiny_bundle, tmp_path, name):
    """They may be the images of the source."""
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_text("mine")
    for option in ([], ["--resume"], ["--overwrite"]):
        assert_refused_at_once(["run", tiny_bundle, DRIVE, "--out", tmp_path, *option])
    assert contents(tmp_path) == {name: b"mine"}


def test_p6_results_are_kept_if_the_bundle_is_invalid(tiny_bundle, tmp_path):
    assert run_app(["run", str(tiny_bundle), DRIVE, "--out", str(tmp_path / "out")]) == 0
    before = contents(tmp_path / "out")
    bad = shutil.copytree(tiny_bundle, tmp_path / "bad")
    with (bad / "decoder.onnx").open("ab") as file:
        file.write(b"x")
    for out in ("out", "fresh"):
        assert run_app(["run", str(bad), DRIVE, "--out", str(tmp_path / out), "--overwrite"]) == 4
    assert contents(tmp_path / "out") == before
    assert not (tmp_path / "fresh").exists()


def test_p6_a_demo_does_not_change_the_results_of_a_run(tmp_path):
    (tmp_path / "run.json").write_text('{"source": "my rig"}')
    (tmp_path / "results.jsonl").write_text("{}\n")
    before = contents(tmp_path)
    assert_refused_at_once(["demo", "--out", tmp_path])
    assert contents(tmp_path) == before


def test_p6_an_existing_bundle_is_refused_at_once(tiny_bundle):
    assert_refused_at_once(["export", "--preset", "tiny", "--random-weights", "--out", tiny_bundle])
