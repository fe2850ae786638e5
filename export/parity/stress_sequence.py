"""The scripted drive: a short drawn drive on which everything happens that a temporal window must survive."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...runtime import Frame
from ...runtime.bundle.manifest import TemporalWindow
from ...runtime.geometry import inverse, rigid, rotation_z
from ...synthetic.drive import SyntheticDrive

_SEED = 9001  # of pictures that no trace has seen


def stress_sequence(width_px: int, height_px: int) -> list[Frame]:
    """12 frames: the window fills and slides (0-4); a frame is dropped (before 5); every camera turns and zooms a
    little (from 6 on); a camera is lost (7), then another two (8); a scene cut (9), after which every camera hangs
    low over the ground; a gap breaks the history (11).
    """
    size = (width_px, height_px)
    first = list(SyntheticDrive(seed=_SEED, frames=10, image_size=size))
    second = list(SyntheticDrive(seed=_SEED + 1, frames=8, image_size=size))
    del first[5]
    first = first[:6] + [_recalibrate(frame) for frame in first[6:]]
    first[7] = _lose(first[7], "CAM_FRONT")
    first[8] = _lose(first[8], "CAM_FRONT_LEFT", "CAM_BACK")
    return [*first, *(_hang_low(second[index]) for index in (0, 1, 7))]


def windows(frames: Sequence[Frame], limits: TemporalWindow) -> list[list[int]]:
    """For each frame the indices of the frames its window must hold, newest first.

    This is the rule of the pipeline's history, written anew from its description, for the reference to go by.
    """
    held: list[list[int]] = []
    for index, frame in enumerate(frames):
        continues = index > 0 and _continues(frames[index - 1], frame, limits)
        past = held[-1][: limits.num_frames - 1] if continues else []
        held.append([index, *past])
    return held


def _continues(before: Frame, now: Frame, limits: TemporalWindow) -> bool:
    elapsed_s = now.timestamp_s - before.timestamp_s
    moved_m = np.linalg.norm(now.global_T_ego[:3, 3] - before.global_T_ego[:3, 3])
    between = before.global_T_ego[:3, :3].T @ now.global_T_ego[:3, :3]
    turned_rad = np.arctan2(np.linalg.norm(between - between.T) / np.sqrt(8), (np.trace(between) - 1) / 2)
    return (
        now.scene == before.scene
        and elapsed_s <= limits.largest_time_delta_s
        and bool(moved_m <= limits.largest_speed_m_s * elapsed_s)
        and bool(turned_rad <= limits.largest_turn_rad_s * elapsed_s)
    )


def _lose(frame: Frame, *cameras: str) -> Frame:
    return replace(frame, images={**frame.images, **dict.fromkeys(cameras)})


def _recalibrate(frame: Frame) -> Frame:
    turn = rigid(rotation_z(np.radians(2.0)), [0.1, -0.05, 0.02])
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


def _hang_low(frame: Frame) -> Frame:
    """Cameras on a circle of 18.3 m, which look straight down through a very wide lens, from 1.93 m.

    Nothing that a model asks for lies within 2 m of a rig on a roof, so that the depth from which on a thing is seen
    (0.1 m) could be another one. From here a query at the height of an object's middle lies 0.93 m away, and 8 m of
    them fit across the picture. With these numbers no border of a picture falls on the centre of a voxel.
    """
    looking_down = np.array([[0.0, -1, 0], [-1, 0, 0], [0, 0, -1]])  # right is -y, down is -x, depth is -z
    cameras = {}
    for index, (name, camera) in enumerate(frame.cameras.items()):
        place = 18.3 * rotation_z(np.radians(60 * index))[:, 0] + [0, 0, 1.93]
        width_px, height_px = camera.width_px, camera.height_px
        lens = np.array([[width_px / 9, 0, width_px / 2], [0, height_px / 9, height_px / 2], [0, 0, 1]])
        cameras[name] = replace(camera, camera_T_ego=rigid(looking_down, -looking_down @ place), intrinsics_px=lens)
    return replace(frame, cameras=cameras)
