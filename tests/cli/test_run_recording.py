"""`duospacenet run --recording` and `--heatmaps` from the command line."""

import sys

import pytest

from duospacenet.cli.main import run_app
from tests.helpers.blocked_imports import call_without
from tests.helpers.recordings import read_mcap, read_rrd

DRIVE = "synthetic:5:1"


def test_both_kinds_of_recordings_are_written_inside_the_output_folder(tiny_bundle, tmp_path, capfd):
    call = ["run", str(tiny_bundle), DRIVE, "--out", str(tmp_path), "--heatmaps"]
    assert run_app([*call, "--recording", str(tmp_path / "drive.mcap")]) == 0
    assert run_app([*call, "--recording", str(tmp_path / "drive.rrd"), "--overwrite"]) == 0
    assert len(read_mcap(tmp_path / "drive.mcap")["/tf"]) == len(read_rrd(tmp_path / "drive.rrd")["/world/ego"]) == 1
    assert (tmp_path / "heatmaps" / "000000.png").exists()
    capfd.readouterr()
    assert run_app([*call, "--recording", str(tmp_path / "drive.rrd")]) == 5
    assert "earlier run" in capfd.readouterr().err


@pytest.mark.parametrize(("name", "package", "extra"), [("a.mcap", "foxglove", "mcap"), ("a.rrd", "rerun", "rerun")])
def test_a_missing_extra_is_named_before_the_run(tiny_bundle, tmp_path, monkeypatch, capfd, name, package, extra):
    monkeypatch.setitem(sys.modules, package, None)
    monkeypatch.delitem(sys.modules, f"duospacenet.drawing.{package}_recording", raising=False)
    out = ["--out", str(tmp_path / "out"), "--recording", str(tmp_path / name)]
    assert run_app(["run", str(tiny_bundle), DRIVE, *out]) == 6
    assert f"pip install 'duospacenet[{extra}]'" in capfd.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_heatmaps_need_neither_pytorch_nor_matplotlib(tiny_bundle, tmp_path):
    blocked = ["torch", "onnx", "matplotlib", "foxglove", "rerun", "duospacenet.evaluation"]
    done = call_without(blocked, ["run", tiny_bundle, DRIVE, "--out", tmp_path, "--heatmaps"])
    assert done.returncode == 0, done.stderr
