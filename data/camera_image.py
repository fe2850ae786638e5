"""The image files of a frame's cameras, read at the size that a bundle needs, and the calibrations for that size."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..runtime.bundle.preprocessing_record import Preprocessing
from ..runtime.frame import Camera
from ..runtime.preprocessing import decoding_reduction
from .images import check_image_header, read_image
from .source import ImageFiles


def read_camera_images(
    files: ImageFiles, index: int, cameras: Mapping[str, Camera], preprocessing: Preprocessing | None
) -> tuple[dict[str, NDArray[np.uint8] | None], dict[str, Camera]]:
    """Read the images of a frame. Returns, by camera, the images and the calibrations for their sizes.

    An image is (height_px, width_px, 3) uint8 BGR.
    files: the source. A lost camera has no file: its image is None, and its calibration stays as it is.
    index: of the frame.
    cameras: the calibrations for the size of the files.
    preprocessing: of the bundle that gets the images. A JPEG file is decoded at a half or a quarter of its size where
        that is enough. None reads the whole size.
    Raises InputError, naming the path.
    """
    images: dict[str, NDArray[np.uint8] | None] = dict.fromkeys(cameras)
    read = dict(cameras)
    for name, camera in cameras.items():
        path = files.image_path(index, name)
        if path is not None:
            images[name], read[name] = _read_camera_image(path, camera, preprocessing)
    return images, read


def check_camera_images(files: ImageFiles, index: int, cameras: Mapping[str, Camera]) -> tuple[str, ...]:
    """Check the image files of a frame by their headers. Returns the lost cameras.

    files, index, cameras: as for `read_camera_images`.
    Raises InputError, naming the file, if one is missing, of another kind, or does not have the calibration's size.
    """
    lost = []
    for name, camera in cameras.items():
        path = files.image_path(index, name)
        if path is None:
            lost.append(name)
        else:
            check_image_header(path, camera.width_px, camera.height_px)
    return tuple(lost)


def _read_camera_image(
    path: Path, camera: Camera, preprocessing: Preprocessing | None
) -> tuple[NDArray[np.uint8], Camera]:
    """Read the image of one camera. Returns it, and the calibration for its size."""
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
