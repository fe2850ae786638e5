"""Resampling of masks, in cases worked by hand."""

import numpy as np
import pytest

from duospacenet.data.mask_resampling import resample_mask


def test_a_mask_is_resampled_at_the_centres_of_the_new_cells():
    mask = np.zeros((6, 4), bool)
    mask[4:, 1] = True
    assert resample_mask(mask, (2, 4)).astype(int).tolist() == [[0, 0, 0, 0], [0, 1, 0, 0]]
    assert resample_mask(mask, (12, 4))[8:, 1].all()
    assert not resample_mask(mask, (12, 4))[:8].any()
    assert resample_mask(mask, (6, 4)) is mask


def test_a_centre_on_a_border_gets_the_cell_with_the_larger_index():
    """Four cells become two: the new centres are at the borders 1 and 3."""
    mask = np.array([[False], [True], [False], [True]])
    assert resample_mask(mask, (2, 1)).ravel().tolist() == [True, True]
    assert resample_mask(~mask, (2, 1)).ravel().tolist() == [False, False]


def test_200_cells_become_64_at_the_centres_of_the_new_ones():
    """nuScenes' masks have 200 x 200 cells and `nano` has 64 x 64. Worked by hand: 3.125 old cells per new cell."""
    mask = np.zeros((200, 200), bool)
    mask[[1, 4, 7, 10, 198], 0] = True
    # The centres of rows 0, 1, 2 and 3 are at 1.5625, 4.6875, 7.8125 and 10.9375; that of row 63 is at 198.4375.
    assert np.flatnonzero(resample_mask(mask, (64, 200))[:, 0]).tolist() == [0, 1, 2, 3, 63]


@pytest.mark.parametrize(("cells", "size"), [(200, 64), (64, 200), (7, 5), (1, 9), (3, 49), (199, 200), (16, 128)])
def test_any_two_grids_agree_with_exact_fractions(cells, size):
    """The oracle walks through the old cells: cell c holds the centre if c / cells <= (2 i + 1) / (2 size) < ..."""
    mask = np.random.default_rng(cells).random((cells, 2)) < 0.5
    resampled = resample_mask(mask, (size, 2))
    for i in range(size):
        (inside,) = (c for c in range(cells) if 2 * size * c <= (2 * i + 1) * cells < 2 * size * (c + 1))
        assert resampled[i].tolist() == mask[inside].tolist()
