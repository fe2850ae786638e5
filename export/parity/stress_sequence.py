"""The stress sequence: a short synthetic sequence with every event that the temporal window must handle."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...model import DuoSpaceNetConfig
from ...runtime import Frame
from ...runtime.geometry import inverse, rigid_transform, rotation_z
from ...synthetic.drive import SyntheticDrive

_SEED = 9001  # no training run uses these scenes: the seeds of training scenes have 19 digits
_NUM_LOSSES = 4  # frames in which some cameras are lost
_JUMP_M = 60.0  # in half a second, above LARGEST_SPEED_M_S
_TURN_RAD = np.radians(120.0)  # in half a second, above LARGEST_TURN_RAD_S


def stress_sequence(config: DuoSpaceNetConfig, size_px: tuple[int, int] | None = None) -> list[Frame]:
    """Frames of two synthetic scenes for a model with N cameras and a window of T frames; 14 frames for T = 4.

    In the first scene the ego drives a curve, pitches, rolls, rises and sinks.
    0: every camera has an image.
    1 to 4: every camera is lost in one of these frames. It stays lost in every slot that the frame moves through.
    5: every camera is lost. The pipeline skips the frame.
    6 to 4 + T: another calibration; every camera is turned by 2 degrees and zooms by 3 %.

    In the second scene every camera is close to the ground. It has five frames: after a scene cut, half a second later,
    after a gap in time, after an ego jump, and after an ego turn. All but the second reset the history.

    size_px: width and height of the images; by default those of the model's input.
    """
    size_px = size_px or (config.image.width_px, config.image.height_px)
    frames = (*_first_scene(config, size_px), *_second_scene(size_px))
    return [_with_num_cameras(frame, config.num_cameras) for frame in frames]


def _first_scene(config: DuoSpaceNetConfig, size_px: tuple[int, int]) -> list[Frame]:
    num_after = max(config.num_frames - 1, 1)  # the frame of the last loss reaches the last slot
    drive = SyntheticDrive(_SEED, 2 + _NUM_LOSSES + num_after, size_px)
    frames = [_move_ego(frame, _uneven_road(index)) for index, frame in enumerate(drive)]
    cameras, skipped = list(frames[0].cameras), 1 + _NUM_LOSSES
    used = cameras[: config.num_cameras]
    if len(used) > 1:
        for index in range(_NUM_LOSSES):
            frames[1 + index] = _lose_cameras(frames[1 + index], used[index::_NUM_LOSSES])
    frames[skipped] = _lose_cameras(frames[skipped], cameras)
    return [*frames[: skipped + 1], *map(_recalibrate, frames[skipped + 1 :])]


def _second_scene(size_px: tuple[int, int]) -> list[Frame]:
    drive = SyntheticDrive(_SEED + 1, 9, size_px)
    cut, next_frame, gap, jump, turn = (_lower_cameras(drive.frame(index)) for index in (0, 1, 6, 7, 8))
    forward = [_JUMP_M, 0.0, 0.0]
    jump = _move_ego(jump, rigid_transform(np.eye(3), forward))
    return [cut, next_frame, gap, jump, _move_ego(turn, rigid_transform(rotation_z(_TURN_RAD), forward))]


def _uneven_road(index: int) -> NDArray[np.float64]:
    """The change (4, 4) of the ego pose of frame `index`: a curve of 5 degrees per frame, bumps and another height."""
    roll, pitch = np.radians(2.5) * np.cos(1.7 * index), np.radians(3.0) * np.sin(1.1 * index)
    about_x = np.array([[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]])
    about_y = np.array([[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]])
    height_m = 0.4 * np.sin(2.3 * index + 1)
    return rigid_transform(rotation_z(np.radians(5.0 * index)) @ about_y @ about_x, [0.0, 0.0, height_m])


def _move_ego(frame: Frame, motion: NDArray[np.float64]) -> Frame:
    """Change the ego pose of a frame by `motion` (4, 4), which is given in the ego frame."""
    return replace(frame, global_T_ego=frame.global_T_ego @ motion)


def _with_num_cameras(frame: Frame, num_cameras: int) -> Frame:
    """The frame with `num_cameras` cameras. If the rig has fewer, its cameras are repeated, turned by 30 degrees."""
    names = list(frame.cameras)
    cameras, images = {}, {}
    for index in range(num_cameras):
        repetition, camera = divmod(index, len(names))
        name = names[camera]
        turn = rigid_transform(rotation_z(np.radians(30.0 * repetition)), [0.0, 0.0, 0.0])
        new_name = f"{name}_{repetition}" if repetition else name
        turned = frame.cameras[name].camera_T_ego @ inverse(turn)
        cameras[new_name] = replace(frame.cameras[name], camera_T_ego=turned) if repetition else frame.cameras[name]
        images[new_name] = frame.images[name]
    return replace(frame, cameras=cameras, images=images)


def _recalibrate(frame: Frame) -> Frame:
    turn = rigid_transform(rotation_z(np.radians(2.0)), [0.1, -0.05, 0.02])
    zoom = np.diag([1.03, 1.03, 1.0])
    cameras = {
        name: replace(
            camera,
            camera_T_ego=camera.camera_T_ego @ inverse(turn),
            intrinsics_px=camera.intrinsics_px @ zoom,
        )
        for name, camera in frame.cameras.items()
    }
    return replace(frame, cameras=cameras)


def _lose_cameras(frame: Frame, cameras: Sequence[str]) -> Frame:
    return replace(frame, images={**frame.images, **dict.fromkeys(cameras)})


def _lower_cameras(frame: Frame) -> Frame:
    """Place the cameras on a circle of radius 18.3 m at a height of 1.93 m, looking straight down, with wide lenses.

    With cameras on a roof, no voxel or query is nearer to a camera than 2 m. An error in the smallest visible depth
    (0.1 m) would then have no effect. Here a query at the height of an object's centre is 0.93 m from the camera, and
    an image covers 8 m at that distance. The numbers are chosen so that no image border is at the centre of a voxel.
    """
    camera_R_ego = np.array([[0.0, -1, 0], [-1, 0, 0], [0, 0, -1]])  # right is -y, down is -x, depth is -z
    cameras = {}
    for index, (name, camera) in enumerate(frame.cameras.items()):
        position = 18.3 * rotation_z(np.radians(60 * index))[:, 0] + [0, 0, 1.93]
        width_px, height_px = camera.width_px, camera.height_px
        lens = np.array([[width_px / 9, 0, width_px / 2], [0, height_px / 9, height_px / 2], [0, 0, 1]])
        cameras[name] = replace(
            camera, camera_T_ego=rigid_transform(camera_R_ego, -camera_R_ego @ position), intrinsics_px=lens
        )
    return replace(frame, cameras=cameras)
