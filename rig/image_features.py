"""Features of images, and matches between the features of two images."""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

WIDTH_PX = 800  # images are scaled to this width: enough for a tenth of a degree, and fast
LARGEST_SCALE = 2.0  # larger images of a small image have no more features
MAX_FEATURES = 1000
LARGEST_RATIO = 0.78  # of the distances to the nearest and the second-nearest feature


class Features(NamedTuple):
    """points_px: (K, 2) in pixels of the image, as given. descriptors: (K, 128) float32."""

    points_px: Array
    descriptors: NDArray[np.float32]


class Matches(NamedTuple):
    """Points of the same things in two images. one_px, other_px: (M, 2) in pixels of the images."""

    one_px: Array
    other_px: Array

    def __len__(self) -> int:  # type: ignore[override]
        return len(self.one_px)


def find_features(image: NDArray[np.uint8]) -> Features:
    """Find the features of an image (height, width, 3) uint8 BGR. An image without content has none."""
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    scale = min(WIDTH_PX / grey.shape[1], LARGEST_SCALE)
    resized = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC)
    keypoints, descriptors = cv2.SIFT.create(MAX_FEATURES).detectAndCompute(resized, None)  # type: ignore[call-overload]
    if descriptors is None:
        return Features(np.zeros((0, 2)), np.zeros((0, 128), np.float32))
    points_px = np.array([keypoint.pt for keypoint in keypoints]) + 0.5  # OpenCV's first pixel has its centre at (0, 0)
    # Square roots of normalised histograms are compared: they tell features apart better than the histograms.
    descriptors = np.sqrt(descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-9))
    return Features(points_px / scale, np.asarray(descriptors, np.float32))


def match_features(one: Features, other: Features) -> Matches:
    """Match the features of two images: each is the nearest of the other, by a margin."""
    if min(len(one.points_px), len(other.points_px)) < 2:
        return Matches(np.zeros((0, 2)), np.zeros((0, 2)))
    similarity = one.descriptors @ other.descriptors.T
    nearest = similarity.argmax(axis=1)
    rows = np.arange(len(nearest))
    is_mutual = similarity.argmax(axis=0)[nearest] == rows
    first = similarity[rows, nearest]
    similarity[rows, nearest] = -1
    second = similarity.max(axis=1)
    # The descriptors have length 1, so that the squared distance is 2 - 2 * similarity.
    is_distinct = (1 - first) < LARGEST_RATIO**2 * (1 - second)
    is_match = is_mutual & is_distinct
    return Matches(one.points_px[is_match], other.points_px[nearest[is_match]])
