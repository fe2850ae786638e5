import json

import numpy as np
import pytest

from duospacenet.data.nuscenes_submission import check_sample_tokens, write_submission
from duospacenet.data.results import frame_result
from duospacenet.runtime import Detections, Frame
from duospacenet.runtime.detections import HistoryReport
from duospacenet.runtime.errors import InputError


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
