"""Preprocessing: from the images and calibration of a frame to the tensors that the graphs take."""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from .bundle.manifest import Preprocessing
from .frame import Camera, Frame
from .geometry import image_T_ego


class NetworkInputs(NamedTuple):
    """The tensors of one frame for N camera slots. Lost cameras and unused slots are not valid.

    images: (N, H, W, 3) uint8 BGR; zeros where not valid.
    image_T_ego: (N, 3, 4) float32, to pixels of these images; zeros for unused slots.
    camera_valid: (N,) bool.
    """

    images: NDArray[np.uint8]
    image_T_ego: NDArray[np.float32]
    camera_valid: NDArray[np.bool_]


def prepare(frame: Frame, preprocessing: Preprocessing, num_cameras: int) -> NetworkInputs:
    """Resize and crop the images of a valid frame, and adapt the projections to the result.

    preprocessing: size of the network's images, from the manifest.
    num_cameras: N, the number of camera slots; at least the number of the frame's cameras, which keep their order.
    """
    images = np.zeros((num_cameras, preprocessing.height_px, preprocessing.width_px, 3), np.uint8)
    projections = np.zeros((num_cameras, 3, 4), np.float32)
    valid = np.zeros(num_cameras, np.bool_)
    for slot, (name, camera) in enumerate(frame.cameras.items()):
        resized_T_image = resize_transform(camera, preprocessing)
        projections[slot] = image_T_ego(resized_T_image @ camera.intrinsics_px, camera.camera_T_ego)
        image = frame.images[name]
        if image is not None:
            images[slot] = _resize(image, resized_T_image, preprocessing)
            valid[slot] = True
    return NetworkInputs(images, projections, valid)


def resize_transform(camera: Camera, preprocessing: Preprocessing) -> NDArray[np.float64]:
    """Return the affine map (3, 3) from pixels of the camera's image to pixels of the network's image.

    The image is scaled so that it covers the network's image, and then cropped. The same number of columns is cropped
    on both sides. Rows are cropped at the top only, because the sky is there. In both images the centre of the first
    pixel is at (0.5, 0.5).
    """
    width, height = preprocessing.width_px, preprocessing.height_px
    scale = max(width / camera.width_px, height / camera.height_px)
    # The resized image has whole pixels, so its exact scale differs slightly between x and y.
    scaled_width, scaled_height = round(camera.width_px * scale), round(camera.height_px * scale)
    left, top = (scaled_width - width) // 2, scaled_height - height  # an odd surplus crops one more column on the right
    return np.array(
        [
            [scaled_width / camera.width_px, 0.0, -left],
            [0.0, scaled_height / camera.height_px, -top],
            [0.0, 0.0, 1.0],
        ]
    )


def _resize(
    image: NDArray[np.uint8], resized_T_image: NDArray[np.float64], preprocessing: Preprocessing
) -> NDArray[np.uint8]:
    """Resize and crop an image by the transform of `resize_transform`."""
    height, width = image.shape[:2]
    scaled = (round(width * resized_T_image[0, 0]), round(height * resized_T_image[1, 1]))
    # Area averaging avoids aliasing when shrinking; enlarging has none, so linear interpolation is enough.
    kernel = cv2.INTER_AREA if scaled[0] < width else cv2.INTER_LINEAR
    resized = image if scaled == (width, height) else cv2.resize(image, scaled, interpolation=kernel)
    left, top = -int(resized_T_image[0, 2]), -int(resized_T_image[1, 2])
    cropped = resized[top : top + preprocessing.height_px, left : left + preprocessing.width_px]
    return np.asarray(cropped, dtype=np.uint8)
