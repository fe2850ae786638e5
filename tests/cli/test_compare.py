"""`duospacenet compare` from end to end."""

import json

from duospacenet.cli.main import run_app
from duospacenet.synthetic.drive import SyntheticDrive
from tests.helpers.run_results import detect_nothing, detect_truth, write_results

DRIVE = "synthetic:5:2"


def test_the_last_argument_is_the_source_and_the_others_are_results(tmp_path, capfd):
    frames = list(SyntheticDrive.parse(DRIVE))
    results = [
        str(write_results(tmp_path / name, frames, detect))
        for name, detect in (("a", detect_truth), ("b", detect_nothing), ("c", detect_truth))
    ]
    out = tmp_path / "out"
    options = ["--frame", "1", "--camera", "CAM_BACK", "--camera", "CAM_FRONT", "--ellipses", "--range", "40"]
    assert run_app(["compare", *results, DRIVE, "--out", str(out), *options, "--json"]) == 0
    assert json.loads(capfd.readouterr().out) == {"out": str(out), "names": ["a", "b", "c"], "frames": [1]}
    assert sorted(path.name for path in out.rglob("*.png")) == ["000001.png", "000001.png"]
    assert run_app(["compare", results[0], DRIVE, "--out", str(tmp_path / "text"), "--frame", "0"]) == 0
    assert "1 results, 1 frames; pictures in" in capfd.readouterr().out.replace("\n", " ")


def test_a_missing_source_or_result_is_a_usage_or_input_error(tmp_path, capfd):
    assert run_app(["compare", DRIVE, "--out", str(tmp_path / "out")]) == 2
    assert f"'{DRIVE}' has no results.jsonl" in capfd.readouterr().err
    assert run_app(["compare", str(tmp_path / "none.jsonl"), DRIVE, "--out", str(tmp_path / "out")]) == 3
    assert "none.jsonl: expected a file; got no such file" in capfd.readouterr().err
    assert not (tmp_path / "out").exists()
