"""The stress sequence contains every event that the parity check must cover."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from duospacenet.export.parity.stress_sequence import stress_sequence
from duospacenet.model import PRESETS
from duospacenet.runtime import Camera, Frame
from duospacenet.runtime.validation import check_camera, check_frame

TINY = PRESETS["tiny"]
SKIPPED = 5


@pytest.fixture(scope="module")
def sequence() -> list[Frame]:
    return stress_sequence(TINY)


def lost_cameras(frame: Frame) -> set[str]:
    return {name for name, image in frame.images.items() if image is None}


def test_every_frame_is_valid(sequence):
    for frame in sequence:
        check_frame(frame, TINY.num_cameras)


def test_every_camera_is_lost_once_and_then_all_at_once(sequence):
    lost = [lost_cameras(frame) for frame in sequence]
    assert sorted(itertools.chain(*lost[:SKIPPED])) == sorted(sequence[0].cameras)
    assert lost[SKIPPED] == set(sequence[0].cameras)
    assert not any([lost[0], *lost[SKIPPED + 1 :]])


def test_the_skipped_frame_leaves_a_gap_of_a_second(sequence):
    times = np.array([frame.timestamp_s for frame in sequence])
    assert times[SKIPPED + 1] - times[SKIPPED - 1] == pytest.approx(1.0, abs=0.05)


def test_the_ego_moves_in_six_degrees_of_freedom(sequence):
    """Angles and heights by hand from the third column and the last column of each pose."""
    poses = np.array([frame.global_T_ego for frame in sequence[:9]])
    steps_m = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    assert steps_m.min() > 1
    tilts_rad = np.arccos(poses[:, 2, 2])
    assert tilts_rad.max() > np.radians(2)
    assert np.ptp(poses[:, 2, 3]) > 0.5
    headings_rad = np.unwrap(np.arctan2(poses[:, 1, 0], poses[:, 0, 0]))
    assert np.ptp(headings_rad) > np.radians(30)


def test_the_calibration_changes_after_the_skipped_frame(sequence):
    focal_px = [frame.cameras["CAM_FRONT"].intrinsics_px[0, 0] for frame in sequence]
    assert len(set(focal_px[: SKIPPED + 1])) == len(set(focal_px[SKIPPED + 1 : 9])) == 1
    assert focal_px[0] != focal_px[8]


def test_the_second_scene_has_a_cut_a_gap_a_jump_and_a_turn(sequence):
    scenes = [frame.scene for frame in sequence]
    assert scenes[8] != scenes[9] == scenes[13]
    times = [frame.timestamp_s for frame in sequence[9:]]
    positions = [frame.global_T_ego[:3, 3] for frame in sequence[9:]]
    headings = [np.arctan2(frame.global_T_ego[1, 0], frame.global_T_ego[0, 0]) for frame in sequence[9:]]
    assert times[1] - times[0] < 2 < times[2] - times[1]
    assert times[3] - times[2] < 2 > times[4] - times[3]
    assert np.linalg.norm(positions[3] - positions[2]) > 70 * (times[3] - times[2])
    assert np.linalg.norm(positions[4] - positions[3]) < 70 * (times[4] - times[3])
    assert np.degrees(headings[4] - headings[3]) % 360 == pytest.approx(120, abs=10)


def test_after_the_scene_cut_queries_and_voxels_are_close_to_the_cameras(sequence):
    """Queries are 1 m above the ground, voxels on the ground; both are tested on a 1 m grid."""
    for frame in sequence[9:11]:
        for name, camera in frame.cameras.items():
            check_camera(name, camera)
            assert _num_seen(camera, height_m=1, depths_m=(0.1, 1)) > 40
            assert _num_seen(camera, height_m=0, depths_m=(0.1, 2)) > 100
    assert not any(_num_seen(camera, 1, (0.1, 1)) for frame in sequence[:9] for camera in frame.cameras.values())


@pytest.mark.parametrize(("num_cameras", "num_frames"), [(1, 4), (5, 1), (7, 4), (12, 2), (6, 8)])
def test_other_numbers_of_cameras_and_frames(num_cameras, num_frames):
    frames = stress_sequence(replace(TINY, num_cameras=num_cameras, num_frames=num_frames))
    for frame in frames:
        check_frame(frame, num_cameras)
        assert len(frame.cameras) == num_cameras
    assert len(frames) == 4 + max(num_frames, 2) + 1 + 5
    lost = set(itertools.chain(*map(lost_cameras, frames[:SKIPPED])))
    assert len(lost) == (num_cameras if num_cameras > 1 else 0)


def _num_seen(camera: Camera, height_m: float, depths_m: tuple[float, float]) -> int:
    """Number of points of a 1 m grid at `height_m` that are in the image and at these depths."""
    count = 0
    for x, y in itertools.product(range(-40, 41), repeat=2):
        right, down, depth, _ = camera.camera_T_ego @ [x, y, height_m, 1]
        if depths_m[0] < depth < depths_m[1]:
            u, v, w = camera.intrinsics_px @ [right, down, depth]
            count += 0 <= u / w < camera.width_px and 0 <= v / w < camera.height_px
    return count
