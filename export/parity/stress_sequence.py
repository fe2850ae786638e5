"""The stress sequence: a short synthetic sequence with every event that the temporal window must handle."""

from dataclasses import replace

import numpy as np

from ...runtime import Frame
from ...runtime.geometry import inverse, rigid_transform, rotation_z
from ...synthetic.drive import SyntheticDrive

_SEED = 9001  # no training run uses these scenes: the seeds of training scenes have 19 digits


def stress_sequence(width_px: int, height_px: int) -> list[Frame]:
    """12 frames of two synthetic scenes, with images of `width_px` x `height_px`.

    0 to 4: the window fills and slides.
    5: the frame before it was dropped.
    6 to 8: another calibration; every camera is turned by 2 degrees and zooms by 3 %.
    7: one camera is lost.
    8: two other cameras are lost.
    9: a scene cut. From here on every camera is close to the ground.
    11: a gap in time that resets the history.
    """
    size = (width_px, height_px)
    first = list(SyntheticDrive(seed=_SEED, frames=10, image_size=size))
    second = list(SyntheticDrive(seed=_SEED + 1, frames=8, image_size=size))
    del first[5]
    first = first[:6] + [_recalibrate(frame) for frame in first[6:]]
    first[7] = _lose_cameras(first[7], "CAM_FRONT")
    first[8] = _lose_cameras(first[8], "CAM_FRONT_LEFT", "CAM_BACK")
    return [*first, *(_lower_cameras(second[index]) for index in (0, 1, 7))]


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


def _lose_cameras(frame: Frame, *cameras: str) -> Frame:
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
