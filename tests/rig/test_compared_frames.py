"""The run of frames whose images are compared: where the vehicle moves, with steps that fit."""

import numpy as np

from duospacenet.rig.compared_frames import compared_frames, pairs_of_frames
from duospacenet.runtime.frame import Frame
from duospacenet.runtime.geometry import rigid_transform


def drive(positions_m, step_s=0.5, scene=lambda index: "scene"):
    return [
        Frame({}, {}, rigid_transform(np.eye(3), [x, 0, 0]), index * step_s, scene(index))
        for index, x in enumerate(positions_m)
    ]


def test_the_run_is_where_the_vehicle_moves():
    parked_then_driving = [0.0] * 20 + [4.0 * step for step in range(1, 6)]
    run = compared_frames(drive(parked_then_driving))
    assert len(run) == 5
    assert run[0] >= 19


def test_frames_at_ten_hertz_are_left_out_until_half_a_second_or_a_distance_has_passed():
    assert np.diff(compared_frames(drive([0.1 * index for index in range(60)], 0.1))).tolist() == [5, 5, 5, 5]
    assert np.diff(compared_frames(drive([0.8 * index for index in range(60)], 0.1))).tolist() == [2, 2, 2, 2]


def test_a_run_stays_within_a_scene():
    run = compared_frames(drive([4.0 * index for index in range(8)], scene=lambda index: str(index // 3)))
    assert len({index // 3 for index in run}) == 1


def test_short_recordings_are_taken_as_they_are():
    assert compared_frames([]) == []
    assert compared_frames(drive([0.0, 4.0, 8.0])) == [0, 1, 2]
    assert pairs_of_frames(drive([0.0, 4.0, 8.0])) == [0, 1, 2]
    assert len(pairs_of_frames(drive([4.0 * index for index in range(500)]))) <= 60
