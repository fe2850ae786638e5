"""Tests of GridMask, against a slow reference that writes the mask stripe by stripe, as in DETR3D."""

import numpy as np
import pytest
import torch

from duospacenet.training import GridMask
from duospacenet.training.samples.grid_mask import Grid, grid_mask

GRIDS = [
    Grid(cell_px=8, stripe_px=4, start_px=(0, 0)),
    Grid(cell_px=8, stripe_px=4, start_px=(7, 3)),
    Grid(cell_px=2, stripe_px=1, start_px=(1, 0)),
    Grid(cell_px=13, stripe_px=7, start_px=(5, 12)),
    Grid(cell_px=31, stripe_px=16, start_px=(30, 2)),
]


def reference_mask(height: int, width: int, grid: Grid) -> np.ndarray:
    """DETR3D: a canvas of ones, 1.5 times the image; stripes of zeros; the centre crop; with mode 1, 1 - mask."""
    canvas = np.ones((int(1.5 * height), int(1.5 * width)), np.float32)
    for i in range(canvas.shape[0] // grid.cell_px):
        first = grid.cell_px * i + grid.start_px[0]
        for row in range(first, min(first + grid.stripe_px, canvas.shape[0])):
            canvas[row, :] = 0
    for i in range(canvas.shape[1] // grid.cell_px):
        first = grid.cell_px * i + grid.start_px[1]
        for column in range(first, min(first + grid.stripe_px, canvas.shape[1])):
            canvas[:, column] = 0
    top, left = (canvas.shape[0] - height) // 2, (canvas.shape[1] - width) // 2
    return 1 - canvas[top : top + height, left : left + width]


def generator_with(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def random_images(*shape: int) -> torch.Tensor:
    return torch.randint(1, 256, shape, dtype=torch.uint8, generator=generator_with(1))


@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize("size", [(32, 80), (33, 41)])
def test_the_mask_equals_the_reference(grid, size):
    expected = reference_mask(*size, grid)
    assert 0 < expected.mean() < 1
    np.testing.assert_array_equal(grid_mask(*size, grid).numpy(), expected == 1)


def test_a_grid_with_a_cell_of_four_pixels_matches_a_mask_by_hand():
    """The canvas is 9×9; the image is its rows and columns 1 to 6. Two complete cells have stripes at 3, 4 and 7, 8.
    In the image, these are the rows and columns 2 and 3.
    """
    keep = grid_mask(6, 6, Grid(4, 2, (3, 3))).int().tolist()
    partial, full = [0, 0, 1, 1, 0, 0], [1] * 6
    assert keep == [partial, partial, full, full, partial, partial]


def test_an_incomplete_cell_of_the_canvas_has_no_stripe():
    """The canvas is 9×9; the image is its rows and columns 1 to 6. One complete cell of 5 has a stripe of 3 at 0."""
    keep = grid_mask(6, 6, Grid(5, 3, (0, 0))).int().tolist()
    partial, full = [1, 1, 0, 0, 0, 0], [1] * 6
    assert keep == [full, full, partial, partial, partial, partial]


def test_masked_pixels_become_zero_and_the_others_do_not_change():
    images, mask = random_images(2, 32, 80, 3), GridMask(probability=1.0)
    masked = mask(images, generator_with(3))
    generator = generator_with(3)
    torch.rand((), generator=generator)
    keep = torch.from_numpy(reference_mask(32, 80, mask.sample_grid(32, generator)) == 1)
    assert masked[:, keep].equal(images[:, keep])
    assert not masked[:, ~keep].any()
    assert 0 < keep.float().mean() < 1


def test_both_layouts_are_masked_equally():
    images = random_images(2, 32, 80, 3)
    last = GridMask(1.0)(images, generator_with(4))
    first = GridMask(1.0)(images.permute(0, 3, 1, 2).float(), generator_with(4))
    assert not last.equal(images)
    assert first.permute(0, 2, 3, 1).equal(last.float())


def test_masked_pixels_get_the_fill_colour_in_both_layouts():
    images, colour = random_images(2, 32, 80, 3), torch.tensor([7.0, 8.0, 9.0])
    black = GridMask(1.0)(images, generator_with(5)) == 0
    for masked in (
        GridMask(1.0)(images, generator_with(5), colour),
        GridMask(1.0)(images.permute(0, 3, 1, 2), generator_with(5), colour).permute(0, 2, 3, 1),
    ):
        assert masked[black].reshape(-1, 3).unique(dim=0).tolist() == [[7, 8, 9]]
        assert masked[~black].equal(images[~black])


def test_the_mask_depends_on_the_generator_only():
    images = random_images(1, 32, 80, 3)
    first, again, other = (GridMask(1.0)(images, generator_with(seed)) for seed in (6, 6, 7))
    assert first.equal(again)
    assert not first.equal(other)


def test_seven_of_ten_calls_mask_by_default():
    images, mask, generator = torch.ones(1, 8, 8, 3), GridMask(), generator_with(0)
    masked = sum(mask(images, generator) is not images for _ in range(2000))
    assert 0.66 < masked / 2000 < 0.74  # four standard deviations


def test_the_probability_grows_linearly_with_the_epochs():
    mask, images = GridMask(0.6), torch.ones(1, 8, 8, 3)
    for epoch, expected in ((0, 0.0), (6, 0.15), (12, 0.3), (24, 0.6)):
        mask.set_epoch(epoch, 24)
        assert mask.probability == pytest.approx(expected)
    mask.set_epoch(0, 24)
    assert all(mask(images, generator_with(seed)) is images for seed in range(20))


def test_grids_are_sampled_from_their_full_range():
    """Cells of 2 to H - 1 pixels; a stripe of half a cell, rounded up; a start anywhere in the first cell."""
    mask, generator = GridMask(), generator_with(0)
    grids = [mask.sample_grid(6, generator) for _ in range(500)]
    assert {(grid.cell_px, grid.stripe_px) for grid in grids} == {(2, 1), (3, 2), (4, 2), (5, 3)}
    starts = {grid.start_px for grid in grids if grid.cell_px == 3}
    assert starts == {(row, column) for row in range(3) for column in range(3)}


@pytest.mark.parametrize("shape", [(32, 80, 3), (1, 2, 32, 80, 3), (2, 4, 32, 80)])
def test_images_of_another_shape_are_refused(shape):
    with pytest.raises(ValueError, match=r"expected \(N, H, W, 3\) or \(N, 3, H, W\); got"):
        GridMask(1.0)(torch.zeros(shape), generator_with(0))
