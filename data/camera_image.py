"""The image file of one camera, read at the size that a bundle needs, and the calibration that describes it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..runtime.bundle.manifest import Preprocessing
from ..runtime.frame import Camera
from ..runtime.preprocessing import decoding_reduction
from .images import read_image


def read_camera_image(
    path: Path, camera: Camera, preprocessing: Preprocessing | None
) -> tuple[NDArray[np.uint8], Camera]:
    """Read the image of a camera. Returns (height_px, width_px, 3) uint8 BGR, and the calibration for this size.

    camera: the calibration for the size of the file.
    preprocessing: of the bundle that gets the image. A JPEG file is decoded at a half or a quarter of its size where
        that is enough. None reads the whole size.
    Raises InputError, naming the path.
    """
    reduction = decoding_reduction(camera, preprocessing) if preprocessing else 1
    image = read_image(path, camera.width_px, camera.height_px, reduction)
    return image, _camera_of_image(camera, image)


def _camera_of_image(camera: Camera, image: NDArray[np.uint8]) -> Camera:
    """Return the calibration for an image that may be a reduced one."""
    height_px, width_px = image.shape[:2]
    if width_px == camera.width_px:
        return camera
    image_T_file = np.diag([width_px / camera.width_px, height_px / camera.height_px, 1.0])
    return replace(camera, intrinsics_px=image_T_file @ camera.intrinsics_px, width_px=width_px, height_px=height_px)
