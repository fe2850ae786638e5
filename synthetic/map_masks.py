"""Ground-truth map masks: outlines on the ground, rasterised on a grid.

A mask (X, Y) covers [-51.2, 51.2] m in x and y. Cell [i, j] is at x_i (forward) and y_j (left).
"""

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

RANGE_M = 51.2  # in x and y
SUBSAMPLES = 5  # per cell and axis; odd, so that the middle subsample is at the centre of the cell


def cells_with_centre_inside(outlines: list[Array], grid: tuple[int, int]) -> NDArray[np.bool_]:
    """A mask (X, Y) of the cells with centres inside an outline (k, 2) [m] of the ego frame."""
    middle = SUBSAMPLES // 2
    return _rasterise(outlines, grid)[:, middle, :, middle]


def cells_touched(outlines: list[Array], grid: tuple[int, int]) -> NDArray[np.bool_]:
    """A mask (X, Y) of the cells that overlap an outline (k, 2) [m] of the ego frame. Thin lines have no gaps."""
    return np.logical_or.reduce(_rasterise(outlines, grid), axis=(1, 3))


def _rasterise(outlines: list[Array], grid: tuple[int, int]) -> NDArray[np.bool_]:
    """A mask (X, S, Y, S) of the subsamples with centres inside an outline."""
    fine = np.zeros((grid[0] * SUBSAMPLES, grid[1] * SUBSAMPLES), dtype=np.uint8)
    for outline in outlines:
        # An OpenCV point is (column, row), which is (y, x) here, in sixteenths of a subsample.
        points = (outline[:, ::-1] + RANGE_M) / (2 * RANGE_M) * fine.shape[::-1] - 0.5
        cv2.fillPoly(fine, [np.rint(points * 16).astype(np.int32)], 1, cv2.LINE_8, 4)
    return fine.reshape(grid[0], SUBSAMPLES, grid[1], SUBSAMPLES).astype(bool)
