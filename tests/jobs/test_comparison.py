"""`compare`: the pictures of chosen frames, and results that do not belong together."""

import json
import os

import cv2
import numpy as np
import pytest

from duospacenet import jobs
from duospacenet.drawing.box_style import PREDICTION_COLOUR
from duospacenet.drawing.comparison_picture import VIEW_PX
from duospacenet.drawing.ellipses import ELLIPSE_COLOUR
from duospacenet.jobs.compared_results import FrameBoxes, split_names
from duospacenet.jobs.comparison import disputed_boxes
from duospacenet.runtime.errors import InputError, OutputError, UsageError
from duospacenet.runtime.frame import GroundTruth
from duospacenet.synthetic.drive import SyntheticDrive
from tests.helpers.pictures import count_hue
from tests.helpers.run_results import detect_nothing, detect_truth, write_results

DRIVE = "synthetic:5:3"


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Two results over the drive: `exact` has the true boxes, `empty` has none."""
    folder = tmp_path_factory.mktemp("results")
    frames = list(SyntheticDrive.parse(DRIVE))
    return [
        write_results(folder / name, frames, detect)
        for name, detect in (("exact", detect_truth), ("empty", detect_nothing))
    ]


def change_line(path, number, change, out):
    """Copy results with one line changed, or left out if `change` returns None."""
    lines = [json.loads(line) for line in (path / "results.jsonl").read_text().splitlines()]
    lines[number] = change(lines[number])
    out.mkdir()
    (out / "results.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines if line is not None))
    return out


def test_every_frame_of_the_results_has_two_pictures(results, tmp_path):
    done = jobs.compare(results, DRIVE, tmp_path / "out", cameras=["CAM_FRONT"])
    assert done.to_dict() == {"out": str(tmp_path / "out"), "names": ["exact", "empty"], "frames": [0, 1, 2]}
    written = sorted(path.relative_to(tmp_path / "out").as_posix() for path in (tmp_path / "out").rglob("*.png"))
    assert written == [f"{folder}/00000{index}.png" for folder in ("above", "cameras") for index in range(3)]
    picture = cv2.imread(str(tmp_path / "out" / "above" / "000001.png"))
    halves = picture[:VIEW_PX, :VIEW_PX], picture[:VIEW_PX, VIEW_PX:]
    assert [count_hue(half, PREDICTION_COLOUR) > 100 for half in halves] == [True, False]
    assert count_hue(picture, ELLIPSE_COLOUR) == 0


def test_frames_are_chosen_by_token_or_index(results, tmp_path):
    token = SyntheticDrive.parse(DRIVE).frame_without_images(2).token
    options = {"cameras": ["CAM_FRONT"], "frames": [token, "0", token], "ellipses": True}
    done = jobs.compare([results[0] / "results.jsonl", results[1]], DRIVE, tmp_path / "out", **options)
    assert done.frames == (2, 0)
    picture = cv2.imread(str(tmp_path / "out" / "above" / "000002.png"))
    assert count_hue(picture, ELLIPSE_COLOUR) > 500  # every true object is in `exact` only


def test_disputed_objects_are_those_of_some_results_only():
    def found(*rows):
        boxes = np.array([[10.0 * row, 0, 0, 2, 4, 2, 0, 0, 0] for row in rows]).reshape(-1, 9)
        return FrameBoxes(boxes, np.ones(len(rows)), ("car",) * len(rows), np.eye(4))

    names = ("vehicle.car", "car", "car", "static_object.bicycle_rack")
    truth = GroundTruth(boxes=np.array([[10.0 * row, 0, 0, 2, 4, 2, 0, 0, 0] for row in range(4)]), classes=names)
    disputed = disputed_boxes(truth, [found(0, 1, 3), found(1)])
    assert disputed[:, 0].tolist() == [0.0]  # both have the second object, none the third; a rack is no object


def refused(error, match, results, out, **options):
    with pytest.raises(error, match=match):
        jobs.compare(results, options.pop("source", DRIVE), out, **options)
    assert not out.exists()


def test_results_with_other_frames_are_refused(results, tmp_path):
    shorter = change_line(results[1], 2, lambda line: None, tmp_path / "shorter")
    message = "shorter/results.jsonl: expected the same frames as .*; got 2 instead of 3, without frame 'synthetic-5-0"
    refused(InputError, message, [results[0], shorter], tmp_path / "out")
    refused(InputError, message, [shorter, results[0]], tmp_path / "out")
    other = change_line(results[1], 2, lambda line: line | {"timestamp_s": 99.0}, tmp_path / "other")
    refused(InputError, "expected the same frames", [results[0], other], tmp_path / "out")
    twice = change_line(results[1], 2, lambda line: line | {"token": "t"}, tmp_path / "twice")
    refused(InputError, "expected only frames of the source; got frame 't'", [twice], tmp_path / "out")


def test_results_of_another_source_or_pose_are_refused(results, tmp_path):
    refused(InputError, "expected only frames of the source", results, tmp_path / "out", source="synthetic:6:3")
    moved = change_line(results[1], 1, lambda line: line | {"global_T_ego": np.eye(4).tolist()}, tmp_path / "moved")
    refused(InputError, "expected the ego pose of the source", [results[0], moved], tmp_path / "out")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"frames": ["3"]}, r"--frame: expected a token, or an index from 0 to 2; got '3'"),
        ({"frames": ["-1"]}, "--frame: expected a token"),
        ({"frames": ["\x1b[2J"]}, r"got '\\x1b\[2J'"),
        ({"cameras": ["FRONT"]}, "--camera: expected CAM_FRONT.*; got 'FRONT'"),
        ({"names": ["one"]}, "--name: expected one name per result, 2; got 1"),
    ],
)
def test_wrong_choices_are_refused(results, tmp_path, options, message):
    refused(UsageError, message, results, tmp_path / "out", **options)


def test_files_that_are_no_results_are_refused(results, tmp_path):
    for name, content, message in (
        ("absent", None, "expected a file; got no such file"),
        ("empty", "", "got an empty file"),
        ("broken", '{"scene": 1}\n', "line 1: expected a frame's results"),
    ):
        path = tmp_path / f"{name}.jsonl"
        if content is not None:
            path.write_text(content)
        refused(InputError, message, [results[0], path], tmp_path / "out")
    repeated = (results[0] / "results.jsonl").read_text()
    (tmp_path / "repeated.jsonl").write_text(repeated + repeated)
    refused(InputError, "line 4: expected each frame once", [tmp_path / "repeated.jsonl"], tmp_path / "out")
    os.mkfifo(tmp_path / "pipe.jsonl")
    refused(InputError, "a named pipe", [tmp_path / "pipe.jsonl"], tmp_path / "out")


def test_folders_with_equal_names_are_told_apart_by_their_paths(results, tmp_path):
    frames = list(SyntheticDrive.parse("synthetic:5:1", grid=(8, 8)))
    folders = [write_results(tmp_path / part / "run", frames, detect_nothing) for part in "ab"]
    done = jobs.compare(folders, "synthetic:5:1", tmp_path / "out", cameras=["CAM_FRONT"])
    assert done.names == tuple(str(folder / "results.jsonl") for folder in folders)


def test_results_over_several_sources_are_compared_on_these_sources(tiny_bundle, tmp_path):
    sources = ["synthetic:5:1", "synthetic:6:1"]
    jobs.run(tiny_bundle, sources, tmp_path / "run")
    done = jobs.compare([tmp_path / "run"], sources, tmp_path / "out", cameras=["CAM_FRONT"])
    assert done.frames == (0, 1)


def test_ellipses_need_class_names_that_are_known(results, tmp_path, monkeypatch):
    def refuse(*_):
        raise InputError("unknown names")

    monkeypatch.setattr(SyntheticDrive, "check_class_names", refuse)
    refused(InputError, "unknown names", results, tmp_path / "out", ellipses=True)


def test_results_come_before_sources(results, tmp_path):
    first, second = map(str, results)
    assert split_names([first, second, DRIVE, "a"]) == ([first, second], [DRIVE, "a"])
    assert split_names(["missing.jsonl", DRIVE]) == (["missing.jsonl"], [DRIVE])
    for names, message in (
        ([DRIVE], f"'{DRIVE}' has no results.jsonl"),
        ([first, second], "expected the source"),
        ([first, DRIVE, second], "expected results before sources"),
    ):
        with pytest.raises(UsageError, match=message):
            split_names(names)


def test_a_folder_with_files_is_not_written_to(results, tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(OutputError, match="expected a new or empty folder"):
        jobs.compare(results, DRIVE, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]
