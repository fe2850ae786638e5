"""Geometric augmentation of camera images: scale, rotation, crop and flip, as in BEVDet (Huang et al., 2021)."""

import cv2
import numpy as np
from numpy.typing import NDArray

SCALES = (0.9, 1.1)
LARGEST_ROTATION_DEG = 5.4
LARGEST_SHIFT = 0.05  # of the image's width and height

Array = NDArray[np.float64]


def sample_image_transform(width_px: int, height_px: int, rng: np.random.Generator) -> Array:
    """Sample `new_T_old` (3, 3) [px]: an affine map from pixels of an image to pixels of the augmented image.

    The image is scaled and rotated about its centre, flipped with probability 1/2, and shifted; both images have the
    same size. The centre of the first pixel is (0.5, 0.5).
    """
    scale = rng.uniform(*SCALES)
    angle_rad = np.deg2rad(rng.uniform(-LARGEST_ROTATION_DEG, LARGEST_ROTATION_DEG))
    shift_px = rng.uniform(-LARGEST_SHIFT, LARGEST_SHIFT, 2) * (width_px, height_px)
    flip = -1.0 if rng.random() < 0.5 else 1.0
    return image_transform((width_px, height_px), scale, angle_rad, shift_px, flip)


def image_transform(size_px: tuple[int, int], scale: float, angle_rad: float, shift_px: Array, flip: float) -> Array:
    """The affine map (3, 3) of `sample_image_transform`.

    size_px: width and height.
    angle_rad: the rotation, from the x axis (right) towards the y axis (down).
    shift_px: (2) right and down, after the other operations.
    flip: -1 to exchange left and right, otherwise 1.
    """
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    linear = scale * np.array([[cos, -sin], [sin, cos]]) @ np.diag([flip, 1.0])
    centre = np.array(size_px) / 2
    new_T_old = np.eye(3)
    new_T_old[:2, :2] = linear
    new_T_old[:2, 2] = centre + shift_px - linear @ centre
    return new_T_old


def transform_image(image: NDArray[np.uint8], new_T_old: Array, fill: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Transform an image (H, W, 3) with linear interpolation.

    new_T_old: (3, 3), an affine map between pixels, with the centre of the first pixel at (0.5, 0.5).
    fill: (3) the colour where the image has no pixels.
    """
    # OpenCV has the centre of the first pixel at (0, 0).
    half = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])
    matrix = np.linalg.inv(half) @ new_T_old @ half
    size = image.shape[1], image.shape[0]
    colour = tuple(float(value) for value in fill)
    moved = cv2.warpAffine(image, matrix[:2], size, flags=cv2.INTER_LINEAR, borderValue=colour)
    return np.asarray(moved, np.uint8)
