"""Resampling of map masks, so that masks of any number of cells can be compared with a model's grid."""

import numpy as np
from numpy.typing import NDArray


def resample_mask(mask: NDArray[np.bool_], grid: tuple[int, ...]) -> NDArray[np.bool_]:
    """Resample a mask (X, Y) to another grid over the same range: each new cell has the value at its centre.

    The centre of new cell i is the point (i + 1/2) · X / grid[0] of the old cells. A centre on the border of two old
    cells, as with half as many cells, gets the value of the cell with the larger index.
    A mask that has this grid already is returned as it is.
    """
    if mask.shape == grid:
        return mask
    rows, columns = (
        (2 * np.arange(size) + 1) * cells // (2 * size) for size, cells in zip(grid, mask.shape, strict=True)
    )
    return mask[np.ix_(rows, columns)]
