"""Preprocessing: from the images and calibration of a frame to the tensors that the graphs take."""

from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from .bundle.preprocessing_record import Preprocessing
from .errors import InputError
from .frame import Camera, Frame
from .geometry import image_T_ego

# Each halving rounds halves up, so two of them are at most one grey level above the mean.
MAX_HALVINGS: Final = 2
DECODING_REDUCTIONS: Final = (4, 2)
MAX_SCALED_PX: Final = 1_000_000_000  # of a scaled image, before the crop; a narrow strip could fill the memory


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

    preprocessing: size of the network's images and the method of shrinking, from the manifest.
    num_cameras: N, the number of camera slots; at least the number of the frame's cameras, which keep their order.
    Raises InputError for a camera whose images are far narrower or lower than the network's.
    """
    images = np.zeros((num_cameras, preprocessing.height_px, preprocessing.width_px, 3), np.uint8)
    projections = np.zeros((num_cameras, 3, 4), np.float32)
    valid = np.zeros(num_cameras, np.bool_)
    for slot, (name, camera) in enumerate(frame.cameras.items()):
        _check_proportions(name, camera, preprocessing)
        resized_T_image = resize_transform(camera, preprocessing)
        projections[slot] = image_T_ego(resized_T_image @ camera.intrinsics_px, camera.camera_T_ego)
        image = frame.images[name]
        if image is not None:
            images[slot] = _resize(image, _scaled_size(camera, preprocessing), preprocessing)
            valid[slot] = True
    return NetworkInputs(images, projections, valid)


def _check_proportions(name: str, camera: Camera, preprocessing: Preprocessing) -> None:
    scaled = _scaled_size(camera, preprocessing)
    if scaled.width * scaled.height > MAX_SCALED_PX:
        raise InputError(
            f"camera {name}: expected proportions like those of the network's input, {preprocessing.width_px}x"
            f"{preprocessing.height_px} px; got {camera.width_px}x{camera.height_px} px. Crop the image."
        )


def resize_transform(camera: Camera, preprocessing: Preprocessing) -> NDArray[np.float64]:
    """Return the affine map (3, 3) from pixels of the camera's image to pixels of the network's image.

    The image is scaled so that it covers the network's image, and then cropped. The same number of columns is cropped
    on both sides. Rows are cropped at the top only, because the sky is there. In both images the centre of the first
    pixel is at (0.5, 0.5).
    """
    scaled = _scaled_size(camera, preprocessing)
    left, top = _crop_offset(scaled, preprocessing)
    return np.array(
        [
            [scaled.width / camera.width_px, 0.0, -left],
            [0.0, scaled.height / camera.height_px, -top],
            [0.0, 0.0, 1.0],
        ]
    )


def decoding_reduction(camera: Camera, preprocessing: Preprocessing) -> int:
    """Return 4, 2 or 1: by how much a decoder may reduce the width and height of an image before `prepare`.

    The reduced image has whole pixels. It is the scaled image, or it is still at least twice as large: a reduction to
    nearly the right size would blur the image that is resized after it.
    """
    scaled = _scaled_size(camera, preprocessing)
    for reduction in DECODING_REDUCTIONS:
        size = _Size(camera.width_px // reduction, camera.height_px // reduction)
        is_whole = (size.width * reduction, size.height * reduction) == (camera.width_px, camera.height_px)
        is_twice = size.width >= 2 * scaled.width and size.height >= 2 * scaled.height
        if is_whole and (size == scaled or is_twice):
            return reduction
    return 1


class _Size(NamedTuple):
    """The size of an image [px]."""

    width: int
    height: int


def _scaled_size(camera: Camera, preprocessing: Preprocessing) -> _Size:
    """Return the size of the smallest scaled image that covers the network's image."""
    scale = max(preprocessing.width_px / camera.width_px, preprocessing.height_px / camera.height_px)
    # The scaled image has whole pixels, so its exact scale differs slightly between x and y.
    return _Size(round(camera.width_px * scale), round(camera.height_px * scale))


def _crop_offset(scaled: _Size, preprocessing: Preprocessing) -> tuple[int, int]:
    """Return the numbers of columns and rows that are cropped on the left and at the top."""
    # An odd surplus of columns crops one more on the right.
    return (scaled.width - preprocessing.width_px) // 2, scaled.height - preprocessing.height_px


def _resize(image: NDArray[np.uint8], scaled: _Size, preprocessing: Preprocessing) -> NDArray[np.uint8]:
    """Scale an image to the size `scaled`, and crop it to the network's image."""
    size = _Size(image.shape[1], image.shape[0])
    halvings = _num_halvings(size, scaled) if preprocessing.resize_shrinking == "area by halvings" else 0
    if halvings or size == scaled:
        # Every pixel is the mean of a separate block, so cropping first gives the same pixels with less work.
        return _halve(_crop(image, scaled, preprocessing, 1 << halvings), halvings)
    # Area averaging avoids aliasing when shrinking; enlarging has none, so linear interpolation is enough.
    kernel = cv2.INTER_AREA if scaled.width < size.width else cv2.INTER_LINEAR
    resized = cv2.resize(image, scaled, interpolation=kernel)
    return _crop(np.asarray(resized, dtype=np.uint8), scaled, preprocessing)


def _num_halvings(size: _Size, scaled: _Size) -> int:
    """Return how many halvings lead exactly from `size` to `scaled`; 0 if none do.

    Halvings before another resize would change its result: its weights would be those of means, not of pixels.
    """
    for halvings in range(1, MAX_HALVINGS + 1):
        if size == (scaled.width << halvings, scaled.height << halvings):
            return halvings
    return 0


def _halve(image: NDArray[np.uint8], times: int) -> NDArray[np.uint8]:
    """Halve an image several times. Each pixel is the mean of 2x2 pixels; halves are rounded up."""
    for _ in range(times):
        # For a factor of exactly 2, OpenCV computes (a + b + c + d + 2) >> 2 with vector instructions.
        half = cv2.resize(image, (image.shape[1] // 2, image.shape[0] // 2), interpolation=cv2.INTER_AREA)
        image = np.asarray(half, dtype=np.uint8)
    return image


def _crop(image: NDArray[np.uint8], scaled: _Size, preprocessing: Preprocessing, factor: int = 1) -> NDArray[np.uint8]:
    """Return the network's part of an image that is `factor` times as large as the scaled image."""
    left, top = (factor * offset for offset in _crop_offset(scaled, preprocessing))
    width, height = factor * preprocessing.width_px, factor * preprocessing.height_px
    return image[top : top + height, left : left + width]
