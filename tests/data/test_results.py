"""The boxes of a line of `results.jsonl`, against values written by hand."""

import json

import numpy as np
import pytest

from duospacenet.data.results import FrameResult, read_results, result_boxes
from duospacenet.runtime.errors import OutputError

RESULT: FrameResult = {
    "boxes": [
        {
            "class": "car",
            "score": 0.9,
            "center_m": [1.0, 2.0, 3.0],
            "size_wlh_m": [4.0, 5.0, 6.0],
            "yaw_rad": 0.7,
            "velocity_m_s": [8.0, 9.0],
            "attribute": "vehicle.moving",
        },
        {
            "class": "traffic_cone",
            "score": 0.3,
            "center_m": [-1.0, -2.0, -3.0],
            "size_wlh_m": [0.4, 0.5, 0.6],
            "yaw_rad": -0.7,
            "velocity_m_s": [0.0, 0.1],
            "attribute": "",
        },
    ]
}

POSE = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
LINE = RESULT | {
    "scene": "yard",
    "token": "first",
    "timestamp_s": 10.0,
    "global_T_ego": POSE,
    "history": {"frames": 1, "reset_reason": None},
    "skipped": None,
    "degraded": False,
    "dropped": {"queries": 0, "map_cells": 0},
    "maps": {},
}


def test_the_columns_of_a_box_are_position_size_yaw_and_velocity():
    boxes, scores, classes, attributes = result_boxes(RESULT)
    np.testing.assert_array_equal(boxes, [[1, 2, 3, 4, 5, 6, 0.7, 8, 9], [-1, -2, -3, 0.4, 0.5, 0.6, -0.7, 0, 0.1]])
    np.testing.assert_array_equal(scores, [0.9, 0.3])
    assert classes == ("car", "traffic_cone")
    assert attributes == ("vehicle.moving", "")


def test_boxes_with_a_lower_score_are_left_out_and_equal_ones_are_not():
    assert result_boxes(RESULT, 0.3).classes == ("car", "traffic_cone")
    assert result_boxes(RESULT, 0.31).classes == ("car",)


def test_a_frame_without_boxes_gives_empty_arrays_of_the_same_shapes():
    boxes, scores, classes, attributes = result_boxes({"boxes": []})
    assert boxes.shape == (0, 9)
    assert scores.shape == (0,)
    assert classes == attributes == ()


@pytest.mark.parametrize(
    "change",
    [
        {"size_wlh_m": [1e300, 1, 1]},
        {"size_wlh_m": [-1, 1, 1]},
        {"center_m": [0, -1e300, 0]},
        {"velocity_m_s": [0, 1e300]},
        {"yaw_rad": 1e300},
    ],
)
def test_numbers_that_no_network_returns_are_refused(tmp_path, change):
    path = tmp_path / "results.jsonl"
    path.write_text(json.dumps(LINE) + "\n")
    assert len(list(read_results(path))) == 1
    path.write_text(json.dumps(LINE | {"boxes": [RESULT["boxes"][0] | change]}) + "\n")
    with pytest.raises(OutputError, match=r"line 1: expected a frame's results"):
        list(read_results(path))


@pytest.mark.parametrize("pose", [[], POSE[:3], [*POSE[:3], [0, 0, 0, 1e300]]])
def test_a_pose_that_is_no_matrix_is_refused(tmp_path, pose):
    path = tmp_path / "results.jsonl"
    path.write_text(json.dumps(LINE | {"global_T_ego": pose}) + "\n")
    with pytest.raises(OutputError, match=r"line 1: expected a frame's results"):
        list(read_results(path))
