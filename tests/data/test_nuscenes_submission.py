import json

import numpy as np
import pytest

from duospacenet.data.nuscenes_submission import SubmissionOptions, check_sample_tokens, write_submission
from duospacenet.data.results import frame_result
from duospacenet.runtime import Detections, Frame
from duospacenet.runtime.detections import HistoryReport
from duospacenet.runtime.errors import InputError, UsageError


def test_boxes_are_converted_to_the_global_frame(tmp_path):
    # The ego is at (100, 50) and heads along global y, so the ego vector (x, y) is (-y, x) in the global frame.
    global_T_ego = np.array([[0.0, -1, 0, 100], [1, 0, 0, 50], [0, 0, 1, 2], [0, 0, 0, 1]])
    frame = Frame({}, {}, global_T_ego, 0.0, token="a")
    box = np.array([[10, -4, 0.5, 2, 4, 1.5, np.pi / 2, 3, -1]], np.float32)
    detections = Detections(box, np.array([0.9], np.float32), ("car",), np.array([7]), HistoryReport(1), token="a")
    skipped = Detections.of_skipped_frame(Frame({}, {}, np.eye(4), 0.5, token="b"), "every camera is lost")
    results = [frame_result(frame, detections, {}), frame_result(frame, skipped, {})]
    write_submission(tmp_path / "submission.json", results)
    submission = json.loads((tmp_path / "submission.json").read_text())
    assert submission["meta"] == {
        "use_camera": True,
        "use_lidar": False,
        "use_radar": False,
        "use_map": False,
        "use_external": False,
    }
    (entry,) = submission["results"]["a"]
    assert submission["results"]["b"] == []
    assert entry["sample_token"] == "a"
    assert entry["translation"] == [104, 60, 2.5]
    assert entry["size"] == [2, 4, 1.5]
    # Yaw 90 degrees in the ego frame is 180 degrees in the global frame: the quaternion is (0, 0, 0, 1).
    np.testing.assert_allclose(entry["rotation"], [0, 0, 0, 1], atol=1e-6)
    assert entry["velocity"] == [1, 3]
    assert (entry["detection_name"], entry["detection_score"]) == ("car", 0.9)
    assert entry["attribute_name"] == "vehicle.moving"


def test_every_frame_needs_its_own_token():
    check_sample_tokens(["a", "b"])
    with pytest.raises(InputError, match=r"frame 2: expected a sample token .*; got 'a' for the second time"):
        check_sample_tokens(["a", "b", "a"])
    with pytest.raises(InputError, match=r"frame 1: expected a sample token .*; got no token"):
        check_sample_tokens(["a", ""])


def results_with_scores(*scores: float) -> list[dict]:
    box = {"class": "car", "center_m": [1, 2, 0.5], "size_wlh_m": [2, 4, 1.5], "yaw_rad": 0.1, "velocity_m_s": [3, 0]}
    boxes = [box | {"score": score, "attribute": "vehicle.stopped"} for score in scores]
    return [{"token": "a", "global_T_ego": np.eye(4).tolist(), "boxes": boxes}]


def written(path, results, **options) -> dict:
    write_submission(path / "submission.json", results, SubmissionOptions(**options))
    return json.loads((path / "submission.json").read_text())


def test_the_attribute_is_the_one_of_the_detection(tmp_path):
    """It is not derived again: a car at 3 m/s would be moving."""
    (entry,) = written(tmp_path, results_with_scores(0.9))["results"]["a"]
    assert entry["attribute_name"] == "vehicle.stopped"


def test_the_best_boxes_are_kept_and_every_sample_stays(tmp_path):
    results = [*results_with_scores(0.9, 0.5, 0.2, 0.1), {**results_with_scores(0.05)[0], "token": "b"}]
    few = written(tmp_path, results, max_boxes=2, min_score=0.1)
    assert {token: [box["detection_score"] for box in boxes] for token, boxes in few["results"].items()} == {
        "a": [0.9, 0.5],
        "b": [],
    }
    confident = written(tmp_path, results, min_score=0.2)
    assert [box["detection_score"] for box in confident["results"]["a"]] == [0.9, 0.5, 0.2]


def test_the_meta_flags_follow_the_data_that_was_used(tmp_path):
    meta = written(tmp_path, [], uses=("camera", "map"))["meta"]
    assert meta == {
        "use_camera": True,
        "use_lidar": False,
        "use_radar": False,
        "use_map": True,
        "use_external": False,
    }


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"uses": ("camera", "sonar")}, "--submission-uses: expected some of camera, .*; got 'sonar'"),
        ({"max_boxes": 501}, "--submission-max-boxes: expected 1 to 500, the limit of nuScenes; got 501"),
        ({"max_boxes": 0}, "--submission-max-boxes: expected 1 to 500, .*; got 0"),
        ({"min_score": 1.5}, r"--submission-min-score: expected 0 to 1; got 1\.5"),
        ({"min_score": float("nan")}, "--submission-min-score: expected 0 to 1; got nan"),
    ],
)
def test_options_that_no_submission_can_have_are_refused(options, message):
    with pytest.raises(UsageError, match=message):
        SubmissionOptions(**options).check()


def test_a_box_takes_fewer_bytes_than_full_precision_would(tmp_path):
    """With all digits of float64 a box has about 400 bytes."""
    rng = np.random.default_rng(0)
    boxes = [
        {
            "class": "construction_vehicle",
            "score": 0.123456,
            "center_m": rng.uniform(-50, 50, 3).round(4).tolist(),
            "size_wlh_m": rng.uniform(1, 5, 3).round(4).tolist(),
            "yaw_rad": 1.234567,
            "velocity_m_s": rng.normal(size=2).round(4).tolist(),
            "attribute": "vehicle.stopped",
        }
    ] * 500
    pose = np.eye(4)
    pose[:2, :2], pose[:3, 3] = [[0.6, -0.8], [0.8, 0.6]], (1234.56789012345, 987.654321098765, 0.123456789)
    result = {"token": "0" * 32, "global_T_ego": pose.tolist(), "boxes": boxes}
    write_submission(tmp_path / "submission.json", [result])
    assert (tmp_path / "submission.json").stat().st_size < 320 * 500
