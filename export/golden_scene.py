"""The scene of the golden example: three frames of a synthetic drive, with everything that a consumer can get wrong."""

import functools
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..model import DuoSpaceNetConfig
from ..runtime import Camera, Frame
from ..runtime.geometry import inverse, rigid_transform, rotation_z
from ..synthetic.drive import SyntheticDrive

NUM_FRAMES = 3
_SEED = 9003  # neither a training drive nor one of the stress sequence
_SCENE = "golden"
_RENDERED_PX = (120, 68)  # of all models; the images are enlarged in blocks, so that their files are small
_LOST = 1  # the frame in which a camera is lost, and the number of this camera
_LARGEST_WIDTH_PX = 4096


def golden_scene(config: DuoSpaceNetConfig) -> list[Frame]:
    """Three frames for a model with N cameras; a rig of at most six cameras.

    The ego drives a curve, pitches, rolls, rises and sinks. In frame 1 a camera is lost. In frame 2 every camera has
    another calibration. The native images have different sizes, see `_native_size`. They have no ground truth.
    """
    frames = [_move_ego(frame, index) for index, frame in enumerate(_rendered_frames())]
    return [_with_native_images(frame, index, config) for index, frame in enumerate(frames)]


@functools.cache
def _rendered_frames() -> tuple[Frame, ...]:
    """The frames with small images, which are the same for every model."""
    return tuple(SyntheticDrive(_SEED, NUM_FRAMES, _RENDERED_PX))


def _move_ego(frame: Frame, index: int) -> Frame:
    """Turn the ego in all three axes, differently in every frame, and change its height."""
    roll, pitch, yaw = np.radians(2.0) * index, np.radians(-1.5) * index, np.radians(4.0) * index
    about_x = np.array([[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]])
    about_y = np.array([[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]])
    motion = rigid_transform(rotation_z(yaw) @ about_y @ about_x, [0.0, 0.0, 0.2 * index])
    token = f"{_SCENE}-{index}"
    return replace(frame, global_T_ego=frame.global_T_ego @ motion, scene=_SCENE, token=token, ground_truth=None)


def _with_native_images(frame: Frame, index: int, config: DuoSpaceNetConfig) -> Frame:
    names = list(frame.cameras)[: config.num_cameras]
    cameras, images = {}, {}
    for number, name in enumerate(names):
        size_px = _native_size(number, config.image.width_px, config.image.height_px)
        image = frame.images[name]
        is_lost = (index, number) == (_LOST, _LOST)
        images[name] = None if is_lost or image is None else _enlarged(image, size_px)
        camera = _resized_camera(frame.cameras[name], size_px)
        cameras[name] = _recalibrated(camera) if index == NUM_FRAMES - 1 else camera
    return replace(frame, cameras=cameras, images=images)


def _native_size(number: int, width_px: int, height_px: int) -> tuple[int, int]:
    """Width and height of the images of camera `number`, for network images of width_px x height_px.

    The sizes lead to every kind of resize that gives the same pixels on every platform: none, one and two halvings, and
    a mean of 3x3 pixels, each with a crop at the top; and a halving with an odd crop at the sides. Other resizes round
    differently in different libraries.
    """
    cut_px = max(1, 2 * height_px // 5)
    factors = [2, 1, 3, 4]
    if number % 5 == 4:
        return 2 * (width_px + 11), 2 * height_px
    factor = factors[number % 5]
    if factor * width_px > _LARGEST_WIDTH_PX:
        factor = 1
    return factor * width_px, factor * (height_px + cut_px)


def _enlarged(image: NDArray[np.uint8], size_px: tuple[int, int]) -> NDArray[np.uint8]:
    """The image with every pixel as a block of pixels, with 16 levels per colour, which makes small files."""
    columns, rows = (
        (np.arange(size) + 0.5) * old // size for size, old in zip(size_px, image.shape[1::-1], strict=True)
    )
    return np.ascontiguousarray((image & 0xF0)[rows.astype(int)[:, None], columns.astype(int)])


def _resized_camera(camera: Camera, size_px: tuple[int, int]) -> Camera:
    width_px, height_px = size_px
    scale = np.diag([width_px / camera.width_px, height_px / camera.height_px, 1.0])
    return Camera(scale @ camera.intrinsics_px, camera.camera_T_ego, width_px, height_px)


def _recalibrated(camera: Camera) -> Camera:
    turn = rigid_transform(rotation_z(np.radians(2.0)), [0.1, -0.05, 0.02])
    return replace(camera, camera_T_ego=camera.camera_T_ego @ inverse(turn))
