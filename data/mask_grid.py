"""The grid of a map mask: its cells, and the part of the ego frame that they cover."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class MaskGrid:
    """The cells of a mask.

    size: number of cells in x and y.
    lower_m, upper_m: corners of the rectangle in the ego frame. The default is the perception range of all presets.
    """

    size: tuple[int, int]
    lower_m: tuple[float, float] = (-51.2, -51.2)
    upper_m: tuple[float, float] = (51.2, 51.2)

    @property
    def cell_m(self) -> NDArray[np.float64]:
        """Length (2,) of a cell in x and y."""
        return np.subtract(self.upper_m, self.lower_m) / self.size

    @property
    def corners(self) -> NDArray[np.float64]:
        """The corners (4, 2) [m] of the rectangle."""
        (x0, y0), (x1, y1) = self.lower_m, self.upper_m
        return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
