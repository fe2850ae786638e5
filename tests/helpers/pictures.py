"""Pinhole cameras, frames and boxes with positions in pictures that can be computed by hand."""

import numpy as np

from duospacenet.drawing.box_style import style_ground_truth
from duospacenet.runtime.frame import Camera, Frame, GroundTruth

# A camera at the origin of the ego frame that looks ahead: x right is -y, y down is -z, z forward is x.
AHEAD = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1.0]])
# The same camera, looking to the left of the ego.
LEFT = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1.0]])
SIZE_PX = (640, 360)
NUSCENES_AZIMUTHS_DEG = {
    "CAM_FRONT": 0,
    "CAM_FRONT_RIGHT": -55,
    "CAM_FRONT_LEFT": 55,
    "CAM_BACK": 180,
    "CAM_BACK_LEFT": 110,
    "CAM_BACK_RIGHT": -110,
}


def make_camera(camera_T_ego=AHEAD, width_px=640, height_px=360):
    """A pinhole camera with a focal length of 200 px and its principal point in the middle."""
    intrinsics_px = np.array([[200, 0, width_px / 2], [0, 200, height_px / 2], [0, 0, 1.0]])
    return Camera(intrinsics_px, camera_T_ego, width_px, height_px)


def looking(azimuth_deg, **size):
    cos, sin = np.cos(np.deg2rad(azimuth_deg)), np.sin(np.deg2rad(azimuth_deg))
    turned = np.eye(4)
    turned[:2, :2] = [[cos, sin], [-sin, cos]]
    return make_camera(AHEAD @ turned, **size)


def make_frame(images, cameras, **names):
    return Frame(images=images, cameras=cameras, global_T_ego=np.eye(4), timestamp_s=12.5, **names)


def surround_frame(lost=()):
    """A frame with the six directions of nuScenes; each image has one grey."""
    cameras = {name: looking(azimuth) for name, azimuth in NUSCENES_AZIMUTHS_DEG.items()}
    images = {name: np.full((360, 640, 3), 100 + 20 * i, np.uint8) for i, name in enumerate(cameras)}
    return make_frame(images | dict.fromkeys(lost), cameras, scene="s", token="t")


def box(x, y, z=0.0, w=2.0, l=4.0, h=2.0, yaw=0.0, vx=0.0, vy=0.0):  # noqa: E741
    return np.array([[x, y, z, w, l, h, yaw, vx, vy]])


def ground_truth_boxes(boxes):
    return style_ground_truth(GroundTruth(boxes=boxes, classes=("car",) * len(boxes)), scale=1.0)


def difference(picture, other):
    """Rows and columns of the pixels that differ by more than the rim of an anti-aliased line."""
    return np.nonzero((np.abs(picture.astype(int) - other) > 60).any(axis=2))


def count_hue(picture, colour):
    """The number of pixels of the hue of a colour, the rims of its anti-aliased lines included.

    colour: BGR, with one channel that is larger than the others.
    """
    channels, strongest = picture.astype(int), int(np.argmax(colour))
    others = np.delete(channels, strongest, axis=2).max(axis=2)
    return int((channels[..., strongest] - others > 50).sum())
