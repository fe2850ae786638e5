"""GridMask (Chen et al., 2020), as DETR3D and the paper's family augment images with it."""

from typing import NamedTuple

import torch
from torch import Tensor


class Grid(NamedTuple):
    """A square grid over a canvas half as large again as the image and around it.

    cell_px: from stripe to stripe; stripe_px: how wide they are; start_px: of the first, from the canvas' top and left.
    """

    cell_px: int
    stripe_px: int
    start_px: tuple[int, int]


class GridMask:
    """Takes squares out of images; DETR3D's with use_h, use_w, rotate=1, offset=False, ratio=0.5, mode=1, prob=0.7.

    Rows and columns of a random grid's stripes are kept, and what lies between both is taken out, in all images of a
    call alike. `rotate=1` turns the mask by 0 degrees.
    """

    def __init__(self, probability: float = 0.7, ratio: float = 0.5) -> None:
        """probability: that a call masks at all; ratio: of a stripe's width to the grid's cell."""
        self.full_probability = self.probability = probability
        self.ratio = ratio

    def set_epoch(self, epoch: int, max_epoch: int) -> None:
        """Let the probability grow with the epochs, from 0 to all of it at `max_epoch`."""
        self.probability = self.full_probability * epoch / max_epoch

    def __call__(self, images: Tensor, generator: torch.Generator, fill: Tensor | None = None) -> Tensor:
        """images (N, H, W, 3) or (N, 3, H, W), of any type; returns them masked, or as they were.

        fill (3): what is put where pixels are taken out, by channel. None is 0, which in normalised images is the mean
        colour; where masking comes before the normalisation, give that. What is random comes from `generator` (CPU).
        """
        channels_last = images.shape[-1] == 3
        if images.dim() != 4 or not (channels_last or images.shape[1] == 3):
            raise ValueError(f"images: expected (N, H, W, 3) or (N, 3, H, W); got {tuple(images.shape)}")
        if torch.rand((), generator=generator) > self.probability:
            return images
        height, width = images.shape[1:3] if channels_last else images.shape[2:]
        keep = grid_mask(height, width, self.draw(height, generator)).to(images.device)
        colour = torch.zeros(3) if fill is None else fill
        colour = colour.to(images) if channels_last else colour.to(images)[:, None, None]
        return torch.where(keep[..., None] if channels_last else keep, images, colour)

    def draw(self, height_px: int, generator: torch.Generator) -> Grid:
        """A grid for images of this height, at least 3 pixels: of cells of 2 to `height_px` - 1."""
        cell = _below(height_px - 2, generator) + 2
        stripe = min(max(int(cell * self.ratio + 0.5), 1), cell - 1)
        return Grid(cell, stripe, (_below(cell, generator), _below(cell, generator)))


def grid_mask(height_px: int, width_px: int, grid: Grid) -> Tensor:
    """(H, W) bool: the pixels to keep, those in a stripe of rows or of columns."""
    rows = _stripes(height_px, grid, grid.start_px[0])
    return rows[:, None] | _stripes(width_px, grid, grid.start_px[1])


def _stripes(size_px: int, grid: Grid, start_px: int) -> Tensor:
    """(size) bool: which rows, or columns, of the image lie in a stripe. The canvas has stripes for its whole cells."""
    canvas = int(1.5 * size_px)
    place = torch.arange(size_px) + (canvas - size_px) // 2 - start_px
    there = (place >= 0) & (place < canvas // grid.cell_px * grid.cell_px)
    return there & (place % grid.cell_px < grid.stripe_px)


def _below(end: int, generator: torch.Generator) -> int:
    return int(torch.randint(end, (), generator=generator))
