"""Commands that take several sources use the frames of all of them."""

import json
import re

from duospacenet.cli.main import run_app
from tests.helpers.train_command import TRAIN_TINY, with_options

SOURCES = ["synthetic:5:3", "synthetic:6:2"]


def test_a_training_uses_the_frames_of_every_source(tmp_path, capfd):
    sources = ["--source", SOURCES[0], "--source", SOURCES[1]]
    assert run_app([*with_options(TRAIN_TINY, "--steps", "1", "--out", tmp_path / "out"), *sources]) == 0
    assert re.search(r"ground truth: \d+ boxes in 5 frames to train on", capfd.readouterr().err)
    record = json.loads((tmp_path / "out" / "training.json").read_text())
    assert "synthetic:5:3 + synthetic:6:2" in json.dumps(record)


def test_a_training_is_not_resumed_with_one_source_less(tmp_path, capfd):
    command = with_options(TRAIN_TINY, "--steps", "1", "--out", tmp_path / "out")
    assert run_app([*command, "--source", SOURCES[0], "--source", SOURCES[1]]) == 0
    assert run_app([*command, "--source", SOURCES[0], "--resume"]) == 2
    assert "the training began with" in capfd.readouterr().err


def test_anchors_are_clustered_from_the_boxes_of_every_source(tmp_path, capfd):
    assert run_app(["anchors", *SOURCES, "--queries", "8", "--out", str(tmp_path / "both.json"), "--json"]) == 0
    both = json.loads(capfd.readouterr().out)
    boxes = []
    for number, source in enumerate(SOURCES):
        assert run_app(["anchors", source, "--queries", "8", "--out", str(tmp_path / f"{number}.json"), "--json"]) == 0
        boxes.append(json.loads(capfd.readouterr().out)["boxes"])
    assert (both["frames"], both["boxes"]) == (5, sum(boxes))
    assert json.loads((tmp_path / "both.json").read_text())["source"] == "synthetic:5:3 + synthetic:6:2"


def test_a_missing_second_source_is_refused_before_anything_is_written(tiny_bundle, tmp_path, capfd):
    for command in (["run", str(tiny_bundle)], ["anchors", "--queries", "8"]):
        out = tmp_path / command[0]
        assert run_app([*command, SOURCES[0], str(tmp_path / "none"), "--out", str(out)]) == 3
        assert "none: expected a scene folder" in capfd.readouterr().err
        assert not out.exists()
