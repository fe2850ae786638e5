"""The stress sequence contains every event that the parity check must cover."""

import itertools

import numpy as np
import pytest

from duospacenet.export.parity.stress_sequence import stress_sequence
from duospacenet.runtime import Camera, Frame
from duospacenet.runtime.validation import check_camera
from tests.helpers.streams import TINY_SIZE_PX


@pytest.fixture(scope="module")
def sequence() -> list[Frame]:
    return stress_sequence(*TINY_SIZE_PX)


def test_a_frame_is_missing_and_the_history_continues(sequence):
    times = np.array([frame.timestamp_s for frame in sequence])
    assert times[5] - times[4] == pytest.approx(1.0, abs=0.05)


def test_the_ego_moves_and_turns(sequence):
    poses = np.array([frame.global_T_ego for frame in sequence[:9]])
    steps_m = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    assert steps_m.min() > 1
    assert not np.array_equal(poses[0, :3, :3], poses[8, :3, :3])


def test_the_calibration_changes_and_cameras_are_lost(sequence):
    intrinsics = [frame.cameras["CAM_FRONT"].intrinsics_px[0, 0] for frame in sequence]
    assert intrinsics[5] == intrinsics[0] != intrinsics[6] == intrinsics[8]
    lost = [[name for name, image in frame.images.items() if image is None] for frame in sequence]
    assert lost[7] == ["CAM_FRONT"]
    assert sorted(lost[8]) == ["CAM_BACK", "CAM_FRONT_LEFT"]
    assert not any(lost[:7] + lost[9:])


def test_a_scene_cut_starts_a_second_scene_with_a_gap_in_it(sequence):
    scenes = [frame.scene for frame in sequence]
    assert scenes[8] != scenes[9] == scenes[11]
    assert sequence[11].timestamp_s - sequence[10].timestamp_s > 2.0


def test_after_the_scene_cut_queries_and_voxels_are_close_to_the_cameras(sequence):
    """Queries are 1 m above the ground, voxels on the ground; both are tested on a 1 m grid."""
    for frame in sequence[9:]:
        for name, camera in frame.cameras.items():
            check_camera(name, camera)
            assert _num_seen(camera, height_m=1, depths_m=(0.1, 1)) > 40
            assert _num_seen(camera, height_m=0, depths_m=(0.1, 2)) > 100
    assert not any(_num_seen(camera, 1, (0.1, 1)) for frame in sequence[:9] for camera in frame.cameras.values())


def _num_seen(camera: Camera, height_m: float, depths_m: tuple[float, float]) -> int:
    """Number of points of a 1 m grid at `height_m` that are in the image and at these depths."""
    count = 0
    for x, y in itertools.product(range(-40, 41), repeat=2):
        right, down, depth, _ = camera.camera_T_ego @ [x, y, height_m, 1]
        if depths_m[0] < depth < depths_m[1]:
            u, v, w = camera.intrinsics_px @ [right, down, depth]
            count += 0 <= u / w < camera.width_px and 0 <= v / w < camera.height_px
    return count
