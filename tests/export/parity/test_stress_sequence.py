"""The scripted drive: what it must hold for a proof over it to mean something."""

import itertools

import numpy as np
import pytest

from duospacenet.export.parity.stress_sequence import stress_sequence, windows
from duospacenet.model import PRESETS
from duospacenet.runtime import Camera, Frame
from duospacenet.runtime.validation import check_camera
from duospacenet.weights.input_contract import temporal_window
from tests.helpers.streams import TINY_SIZE_PX


@pytest.fixture(scope="module")
def drive() -> list[Frame]:
    return stress_sequence(*TINY_SIZE_PX)


def test_the_windows_fill_slide_and_break_where_the_script_says(drive):
    held = windows(drive, temporal_window(PRESETS["tiny"]))
    assert [len(window) for window in held] == [1, 2, 3, 4, 4, 4, 4, 4, 4, 1, 2, 1]
    assert held[6] == [6, 5, 4, 3]
    assert held[10] == [10, 9]


def test_a_frame_is_dropped_and_the_history_survives_it(drive):
    times = np.array([frame.timestamp_s for frame in drive])
    assert times[5] - times[4] == pytest.approx(1.0, abs=0.05)


def test_the_ego_moves_and_turns(drive):
    poses = np.array([frame.global_T_ego for frame in drive[:9]])
    steps_m = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    assert steps_m.min() > 1
    assert not np.array_equal(poses[0, :3, :3], poses[8, :3, :3])


def test_the_calibration_changes_and_cameras_are_lost(drive):
    intrinsics = [frame.cameras["CAM_FRONT"].intrinsics_px[0, 0] for frame in drive]
    assert intrinsics[5] == intrinsics[0] != intrinsics[6] == intrinsics[8]
    lost = [[name for name, image in frame.images.items() if image is None] for frame in drive]
    assert lost[7] == ["CAM_FRONT"]
    assert sorted(lost[8]) == ["CAM_BACK", "CAM_FRONT_LEFT"]
    assert not any(lost[:7] + lost[9:])


def test_a_scene_is_cut_and_a_gap_breaks_the_second(drive):
    scenes = [frame.scene for frame in drive]
    assert scenes[8] != scenes[9] == scenes[11]
    assert drive[11].timestamp_s - drive[10].timestamp_s > 2.0


def test_after_the_scene_cut_things_lie_close_to_the_cameras_and_in_sight(drive):
    """Objects and voxels are a metre apart here; objects lie 1 m over the ground, and voxels on it."""
    for frame in drive[9:]:
        for name, camera in frame.cameras.items():
            check_camera(name, camera)
            assert _num_seen(camera, height_m=1, depths_m=(0.1, 1)) > 40
            assert _num_seen(camera, height_m=0, depths_m=(0.1, 2)) > 100
    assert not any(_num_seen(camera, 1, (0.1, 1)) for frame in drive[:9] for camera in frame.cameras.values())


def _num_seen(camera: Camera, height_m: float, depths_m: tuple[float, float]) -> int:
    """Points of a square metre's raster that a camera sees at these depths, one by one."""
    count = 0
    for x, y in itertools.product(range(-40, 41), repeat=2):
        right, down, depth, _ = camera.camera_T_ego @ [x, y, height_m, 1]
        if depths_m[0] < depth < depths_m[1]:
            u, v, w = camera.intrinsics_px @ [right, down, depth]
            count += 0 <= u / w < camera.width_px and 0 <= v / w < camera.height_px
    return count
