"""Rasterises polygons and lines of the ego frame on a grid of cells.

A mask (X, Y) covers a rectangle of the ego frame. Cell [i, j] is at x_i (forward) and y_j (left).
"""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from ..mask_grid import MaskGrid

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

LEAST_SUBSAMPLES = 5  # per cell and axis
LEAST_FINE_CELLS = 1000  # per axis, so that edges are as precise on a coarse grid
LINE_WIDTH_M = 1.024  # two cells of 102.4 m / 200, as the lines of PETRv2
SHIFT_BITS = 4  # OpenCV takes positions in fixed point: sixteenths of a pixel


def fill_polygons(polygons: Sequence[Sequence[Array]], grid: MaskGrid) -> Mask:
    """A mask (X, Y) of the cells whose centre is in a polygon.

    polygons: the rings (k, 2) [m] of each polygon, in the ego frame: the exterior and the holes. Polygons may overlap;
        a hole of one polygon does not cut another.
    """
    subsamples = [_odd(max(LEAST_SUBSAMPLES, -(-LEAST_FINE_CELLS // size))) for size in grid.size]
    fine = np.zeros(np.multiply(grid.size, subsamples), np.uint8)
    for rings in polygons:
        # With all rings in one call, OpenCV fills by the even-odd rule, which leaves out the holes.
        cv2.fillPoly(fine, [_to_pixels(ring, grid, subsamples) for ring in rings], 1, cv2.LINE_8, SHIFT_BITS)
    return fine[subsamples[0] // 2 :: subsamples[0], subsamples[1] // 2 :: subsamples[1]].astype(bool)


def draw_lines(lines: Sequence[Array], grid: MaskGrid) -> Mask:
    """A mask (X, Y) of lines (k, 2) [m] in the ego frame, about `LINE_WIDTH_M` wide and at least one cell.

    OpenCV draws the lines, as in PETRv2. Its line of two cells covers about three, because both edges are included.
    """
    mask = np.zeros(grid.size, np.uint8)
    width = max(1, round(LINE_WIDTH_M / float(grid.cell_m.mean())))
    pixels = [_to_pixels(line, grid, (1, 1)) for line in lines]
    cv2.polylines(mask, pixels, False, 1, width, cv2.LINE_8, SHIFT_BITS)
    return mask.astype(bool)


def _to_pixels(points: Array, grid: MaskGrid, subsamples: Sequence[int]) -> NDArray[np.int32]:
    """Points (k, 2) [m] in OpenCV's fixed-point pixels, as (column, row), which is (y, x).

    In OpenCV, whole numbers are the centres of pixels.
    """
    pixels = (points - grid.lower_m) / grid.cell_m * subsamples - 0.5
    return np.rint(pixels[:, ::-1] * (1 << SHIFT_BITS)).astype(np.int32)


def _odd(number: int) -> int:
    return number + 1 - number % 2
