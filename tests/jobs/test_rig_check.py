"""The check of a rig as a function: its files are those of the command, and replace earlier ones when complete."""

from shutil import copytree

import numpy as np
import pytest

from duospacenet.cli.main import run_app
from duospacenet.jobs import check_rig, rig_check
from duospacenet.jobs.folder_lock import lock_folder
from duospacenet.runtime.errors import OutputError
from tests.helpers.output_files import contents
from tests.helpers.rigs import change_extrinsics, write_rig

INVERTED = change_extrinsics("FRONT", np.linalg.inv)


def test_the_job_writes_the_same_files_as_the_command(tmp_path, capfd):
    rig = write_rig(tmp_path / "rig", INVERTED)
    check = check_rig(rig, tmp_path / "job")
    printed = capfd.readouterr()
    assert printed.out == printed.err == ""
    assert check.broken == ["camera FRONT"]
    assert run_app(["check-rig", str(rig), "--out", str(tmp_path / "command")]) == 1
    assert contents(tmp_path / "job") == contents(tmp_path / "command")


def without_back(scene):
    del scene["cameras"]["BACK"]
    for frame in scene["frames"]:
        del frame["cameras"]["BACK"]


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    return write_rig(tmp_path_factory.mktemp("rigs") / "rig")


@pytest.fixture(scope="module")
def checked(rig, tmp_path_factory):
    """The folder of a check. Tests use copies of it."""
    out = tmp_path_factory.mktemp("checked") / "out"
    check_rig(rig, out, num_frames=1)
    return out


@pytest.fixture
def out(checked, tmp_path):
    return copytree(checked, tmp_path / "out")


@pytest.mark.parametrize(
    ("failing", "exception"), [("examine", KeyboardInterrupt()), ("draw_rig_coverage", OutputError("the disk is full"))]
)
def test_a_check_that_fails_leaves_the_earlier_files_unchanged(tmp_path, out, monkeypatch, failing, exception):
    def fail(*arguments):
        raise exception

    earlier = contents(out)
    monkeypatch.setattr(rig_check, failing, fail)
    with pytest.raises(type(exception)):
        check_rig(write_rig(tmp_path / "other", INVERTED), out, num_frames=1, overwrite=True)
    assert contents(out) == earlier
    assert sorted(path.name for path in out.iterdir()) == ["cameras", "coverage.png", "rig.json"]


@pytest.mark.parametrize("state", [".check-rig-finished", ".check-rig-moving"])
def test_a_replacement_that_was_interrupted_is_completed_by_the_next_check(tmp_path, out, state):
    check_rig(write_rig(tmp_path / "three", without_back), out / state, num_frames=1)
    if state == ".check-rig-moving":
        (out / "cameras" / "BACK.png").unlink()
    check_rig(tmp_path / "three", out, num_frames=1, overwrite=True)
    pictures = [f"cameras/{name}.png" for name in ("FRONT", "LEFT", "RIGHT")]
    assert sorted(contents(out)) == [*pictures, "coverage.png", "rig.json"]


def test_a_finished_check_that_was_not_moved_is_only_replaced_with_overwrite(rig, tmp_path, checked):
    copytree(checked, tmp_path / "out" / ".check-rig-finished")
    before = contents(tmp_path / "out")
    with pytest.raises(OutputError, match="an earlier check wrote this"):
        check_rig(rig, tmp_path / "out", num_frames=1)
    assert contents(tmp_path / "out") == before


def test_an_unfinished_run_in_the_same_folder_is_kept(rig, out):
    unfinished = out / ".duospacenet-new" / "results.jsonl"
    unfinished.parent.mkdir()
    unfinished.write_text("{}")
    check_rig(rig, out, num_frames=1, overwrite=True)
    assert unfinished.read_text() == "{}"


def test_two_checks_cannot_write_to_the_same_folder_at_once(rig, out):
    before = contents(out)
    with lock_folder(out), pytest.raises(OutputError, match="another run is writing there"):
        check_rig(rig, out, num_frames=1, overwrite=True)
    assert contents(out) == before
