"""GridMask (Chen et al., 2020), an image augmentation, with the settings of DETR3D."""

from typing import NamedTuple

import torch
from torch import Tensor


class Grid(NamedTuple):
    """A square grid of stripes on a canvas around the image. The canvas is 1.5 times as large as the image.

    cell_px: the period of the stripes.
    stripe_px: the width of a stripe.
    start_px: the row and the column on the canvas where the first horizontal and the first vertical stripe start.
    """

    cell_px: int
    stripe_px: int
    start_px: tuple[int, int]


class GridMask:
    """Masks squares in images, as DETR3D with use_h, use_w, rotate=1, offset=False, ratio=0.5, mode=1, prob=0.7.

    The rows and the columns in stripes of a random grid are kept, and the squares between them are masked. All images
    of a call have the same mask. `rotate=1` means a rotation of 0 degrees.

    probability: the probability that a call masks its images.
    ratio: the width of a stripe, as a fraction of the period.
    """

    def __init__(self, probability: float = 0.7, ratio: float = 0.5) -> None:
        self.full_probability = self.probability = probability
        self.ratio = ratio

    def set_epoch(self, epoch: int, max_epoch: int) -> None:
        """Set the probability for an epoch. It grows linearly from 0 to the full probability at `max_epoch`."""
        self.probability = self.full_probability * epoch / max_epoch

    def __call__(self, images: Tensor, generator: torch.Generator, fill: Tensor | None = None) -> Tensor:
        """Mask the images, or return them unchanged.

        images: (N, H, W, 3) or (N, 3, H, W), of any type.
        generator: the only source of random numbers (CPU).
        fill: (3) the value of masked pixels per channel; by default 0, which is the mean colour of normalised images.
            For images that are normalised later, pass their mean colour.

        Raises ValueError for images of another shape.
        """
        channels_last = images.shape[-1] == 3
        if images.dim() != 4 or not (channels_last or images.shape[1] == 3):
            raise ValueError(f"images: expected (N, H, W, 3) or (N, 3, H, W); got {tuple(images.shape)}")
        if torch.rand((), generator=generator) > self.probability:
            return images
        height, width = images.shape[1:3] if channels_last else images.shape[2:]
        keep = grid_mask(height, width, self.sample_grid(height, generator)).to(images.device)
        colour = torch.zeros(3) if fill is None else fill
        colour = colour.to(images) if channels_last else colour.to(images)[:, None, None]
        return torch.where(keep[..., None] if channels_last else keep, images, colour)

    def sample_grid(self, height_px: int, generator: torch.Generator) -> Grid:
        """Sample a grid with cells of 2 to `height_px` - 1 pixels. `height_px` must be at least 3."""
        cell = _random_below(height_px - 2, generator) + 2
        stripe = min(max(int(cell * self.ratio + 0.5), 1), cell - 1)
        return Grid(cell, stripe, (_random_below(cell, generator), _random_below(cell, generator)))


def grid_mask(height_px: int, width_px: int, grid: Grid) -> Tensor:
    """The pixels to keep, (H, W) bool: those in a horizontal or in a vertical stripe."""
    rows = _in_stripe(height_px, grid, grid.start_px[0])
    return rows[:, None] | _in_stripe(width_px, grid, grid.start_px[1])


def _in_stripe(size_px: int, grid: Grid, start_px: int) -> Tensor:
    """Whether each row, or column, of the image is in a stripe, (size) bool.

    As in DETR3D, the canvas has as many stripes as complete cells; the rest of the canvas has none.
    """
    canvas_px = int(1.5 * size_px)
    position = torch.arange(size_px) + (canvas_px - size_px) // 2 - start_px
    in_cells = (position >= 0) & (position < canvas_px // grid.cell_px * grid.cell_px)
    return in_cells & (position % grid.cell_px < grid.stripe_px)


def _random_below(end: int, generator: torch.Generator) -> int:
    return int(torch.randint(end, (), generator=generator))
