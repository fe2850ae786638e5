"""The panels of a frame's features: the images as the network sees them, PV heatmaps and the BEV heatmap."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from ..runtime.bundle.preprocessing_record import Preprocessing
from ..runtime.frame import Camera
from ..runtime.geometry import image_T_ego
from ..runtime.preprocessing import resize_transform
from .bird_eye_view import draw_ego
from .camera_panel import empty_panel
from .canvas import Picture
from .heat import colour_heat, heat_of, scale_of

Array = NDArray[np.float64]
Features = NDArray[np.float32]


class FeatureMaps(NamedTuple):
    """The features of one frame.

    pv: by camera name, (C, h, w) of one level; cameras without an image are absent. None without PV features.
    bev: (C, X, Y); [:, i, j] is the cell at x_i (forward) and y_j (left). None for a model without BEV.
    """

    pv: Mapping[str, Features] | None
    bev: Features | None


def draw_network_image(
    image: NDArray[np.uint8] | None, camera: Camera, preprocessing: Preprocessing, size_px: tuple[int, int]
) -> Picture:
    """Draw the part of an image that the network sees, resized to `size_px`. A lost camera has a dark panel."""
    if image is None:
        return empty_panel(None, size_px, 1.0)
    # A decoder may have reduced the image, so its size need not be that of the calibration.
    resolution = np.array([image.shape[1] / camera.width_px, image.shape[0] / camera.height_px])
    resized_T_image = resize_transform(camera, preprocessing)
    scale, offset = np.diag(resized_T_image)[:2], resized_T_image[:2, 2]
    start = -offset / scale * resolution
    end = (np.array([preprocessing.width_px, preprocessing.height_px]) - offset) / scale * resolution
    (left, top), (right, bottom) = np.rint(start).astype(int), np.rint(end).astype(int)
    return empty_panel(image[max(0, top) : bottom, max(0, left) : right], size_px, 1.0)


def draw_pv_heat(
    features: Mapping[str, Features], preprocessing: Preprocessing, size_px: tuple[int, int]
) -> dict[str, Picture]:
    """Draw the PV heatmap of each camera, all with the same scale of colours.

    features: (C, h, w) by camera name. At the right and at the bottom they may reach beyond the image.
    """
    if not features:
        return {}
    heat = heat_of(np.stack(list(features.values())))
    scale = scale_of(heat)
    height, width = heat.shape[1:]
    # The stride of a level is a power of two. Its size is rounded up, so the last cells may be partly outside.
    stride = 2 ** round(np.log2(preprocessing.width_px / width))
    covered = np.array([width, height]) * stride / (preprocessing.width_px, preprocessing.height_px)
    whole_px = (max(size_px[0], round(size_px[0] * covered[0])), max(size_px[1], round(size_px[1] * covered[1])))
    pictures = (colour_heat(each, scale, whole_px)[: size_px[1], : size_px[0]] for each in heat)
    return dict(zip(features, pictures, strict=True))


def draw_bev_heat(features: Features, range_m: float, size_px: int) -> Picture:
    """Draw the BEV heatmap (size_px, size_px, 3) with the ego. Forward is up, left is left.

    features: (C, X, Y) of x and y in [-range_m, range_m].
    """
    heat = heat_of(features[None])
    # The first row is the farthest ahead and the first column the farthest left, so both axes are flipped.
    flipped = np.ascontiguousarray(heat[0, ::-1, ::-1])
    view = colour_heat(flipped, scale_of(heat), (size_px, size_px))
    draw_ego(view, range_m, 1.0)
    return view


def network_projection(camera: Camera, preprocessing: Preprocessing, size_px: tuple[int, int]) -> Array:
    """The projection (3, 4) from the ego frame to the pixels of the network's image resized to `size_px`."""
    resize = np.diag([size_px[0] / preprocessing.width_px, size_px[1] / preprocessing.height_px, 1.0])
    intrinsics_px = resize @ resize_transform(camera, preprocessing) @ camera.intrinsics_px
    return image_T_ego(intrinsics_px, camera.camera_T_ego)


def cut_square(picture: Picture, centre: Sequence[float] | Array, side_px: float, size_px: int) -> Picture:
    """Cut a square out of a picture, and resize it to (size_px, size_px). It is black outside of the picture."""
    scale = size_px / side_px
    shift = size_px / 2 - scale * np.asarray(centre) + 0.5 * (scale - 1)  # in OpenCV, the first pixel is at (0, 0)
    matrix = np.array([[scale, 0, shift[0]], [0, scale, shift[1]]])
    return np.asarray(cv2.warpAffine(picture, matrix, (size_px, size_px), flags=cv2.INTER_LINEAR), dtype=np.uint8)
