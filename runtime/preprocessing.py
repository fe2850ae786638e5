"""From a frame's pictures and calibration to the tensors that the graphs take."""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from .bundle.manifest import Preprocessing
from .frame import Camera, Frame
from .geometry import image_T_ego


class NetworkInputs(NamedTuple):
    """One frame as the graphs see it; slots of cameras that are lost, or that the rig has not, are zero.

    images (N, H, W, 3) uint8 BGR; image_T_ego (N, 3, 4) float32 [px of those images]; camera_valid (N) bool.
    """

    images: NDArray[np.uint8]
    image_T_ego: NDArray[np.float32]
    camera_valid: NDArray[np.bool_]


def prepare_inputs(frame: Frame, preprocessing: Preprocessing, num_cameras: int) -> NetworkInputs:
    """Scale and cut every picture of a checked frame; the projections follow."""
    images = np.zeros((num_cameras, preprocessing.height_px, preprocessing.width_px, 3), np.uint8)
    projections = np.zeros((num_cameras, 3, 4), np.float32)
    valid = np.zeros(num_cameras, np.bool_)
    for slot, (name, camera) in enumerate(frame.cameras.items()):
        resized_T_image = resize_transform(camera, preprocessing)
        projections[slot] = image_T_ego(resized_T_image @ camera.intrinsics_px, camera.camera_T_ego)
        picture = frame.images[name]
        if picture is not None:
            images[slot] = _resize(picture, resized_T_image, preprocessing)
            valid[slot] = True
    return NetworkInputs(images, projections, valid)


def resize_transform(camera: Camera, preprocessing: Preprocessing) -> NDArray[np.float64]:
    """The affine map (3, 3) from the camera's pixels to the network's, pixel centres at halves in both.

    It scales the picture to cover the network's input and cuts the sides equally and the height at the top, where
    the sky is.
    """
    width, height = preprocessing.width_px, preprocessing.height_px
    scale = max(width / camera.width_px, height / camera.height_px)
    scaled_width, scaled_height = round(camera.width_px * scale), round(camera.height_px * scale)
    left, top = (scaled_width - width) // 2, scaled_height - height
    return np.array(
        [
            [scaled_width / camera.width_px, 0.0, -left],
            [0.0, scaled_height / camera.height_px, -top],
            [0.0, 0.0, 1.0],
        ]
    )


def _resize(
    picture: NDArray[np.uint8], resized_T_image: NDArray[np.float64], preprocessing: Preprocessing
) -> NDArray[np.uint8]:
    height, width = picture.shape[:2]
    scaled = (round(width * resized_T_image[0, 0]), round(height * resized_T_image[1, 1]))
    kernel = cv2.INTER_AREA if scaled[0] < width else cv2.INTER_LINEAR
    resized = picture if scaled == (width, height) else cv2.resize(picture, scaled, interpolation=kernel)
    left, top = -int(resized_T_image[0, 2]), -int(resized_T_image[1, 2])
    cut = resized[top : top + preprocessing.height_px, left : left + preprocessing.width_px]
    return np.asarray(cut, dtype=np.uint8)
