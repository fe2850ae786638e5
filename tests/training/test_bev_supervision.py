"""Bird's-eye supervision, against cells and distances worked out by hand and in loops."""

import math

import pytest
import torch

from duospacenet.model.duospacenet import FrameFeatures
from duospacenet.training.bev_supervision import BEVSupervisionHead
from tests.helpers.trainings import TINY, synthetic_training_frames

NUM_CLASSES = len(TINY.classes)
COUNT, CELL_M, LOWER_M = 16, 6.4, -51.2  # the tiny model's grid


@pytest.fixture
def head():
    return BEVSupervisionHead(TINY)


def box_at(x, y, width=1.0, length=1.0):
    return [x, y, 1.0, width, length, 1.5, 0.0, 2.0, 3.0]


def losses_where_the_head_says(head, maps, boxes, labels):
    """Of a frame; maps (1, classes + 10, X, Y): what the head gives."""
    (sample,) = synthetic_training_frames(1, 1)
    ground_truth = {"boxes": torch.tensor(boxes).reshape(-1, 9), "labels": torch.tensor(labels, dtype=torch.long)}
    return {name: float(loss) for name, loss in head.losses(maps, sample._replace(**ground_truth)).items()}


def says_nothing():
    return torch.zeros(1, NUM_CLASSES + 10, COUNT, COUNT)


def test_an_object_lies_in_the_row_of_its_x_and_the_column_of_its_y(head):
    """51.2 m and 6.4 m a cell: x = -51.2 + 6.4 · 3.5 is row 3; y = 50 is column 15; on a border, the next; on the last
    border, the last.
    """
    boxes = torch.tensor([box_at(-28.8, 50.0), box_at(0.0, -51.2), box_at(51.2, 51.2)])
    row, column = head.cells(boxes)
    assert row.tolist() == [3, 8, 15]
    assert column.tolist() == [15, 0, 15]


def test_the_box_loss_is_the_mean_distance_of_the_nine_cells(head):
    """Weights (2, 2, 2, 1, ...), by a quarter; the head says nothing, so that cells give their own centres."""
    x, y = -20.0, 13.0
    losses = losses_where_the_head_says(head, says_nothing(), [box_at(x, y, 2.0, 4.0)], [0])
    others = 2 * 1.0 + math.log(2) + math.log(4) + math.log(1.5) + 0.0 + 1.0 + 2.0 + 3.0
    row, column = 4, 10  # (51.2 - 20) / 6.4 = 4.9; (51.2 + 13) / 6.4 = 10.03
    total = 0.0
    for i in (row - 1, row, row + 1):
        for j in (column - 1, column, column + 1):
            away = abs(LOWER_M + (i + 0.5) * CELL_M - x) + abs(LOWER_M + (j + 0.5) * CELL_M - y)
            total += 2 * away + others
    assert losses["box_bev"] == pytest.approx(0.25 * total / 9, rel=1e-5)


def test_a_cell_says_where_from_its_own_centre(head):
    """Cell (8, 8) has its centre at (3.2, 3.2) m; the object is at (1, 1), and only its own cell says so."""
    maps = says_nothing()
    before = losses_where_the_head_says(head, maps, [box_at(1.0, 1.0)], [0])["box_bev"]
    maps[0, NUM_CLASSES : NUM_CLASSES + 2, 8, 8] = torch.tensor([-2.2, -2.2])
    after = losses_where_the_head_says(head, maps, [box_at(1.0, 1.0)], [0])["box_bev"]
    assert before - after == pytest.approx(0.25 * 2 * (2.2 + 2.2) / 9, rel=1e-4)


def test_the_head_gives_logits_and_poses_on_the_grid(head):
    bev = torch.zeros(1, TINY.channels, COUNT, COUNT)
    assert head(FrameFeatures([], bev)).shape == (1, NUM_CLASSES + 10, COUNT, COUNT)


def test_a_cell_between_two_objects_learns_the_nearer():
    """In the cells (8, 8) and (8, 9), at their centres: of the twelve cells around them each learns its own three, and
    of the columns between, each object its own.
    """
    head = BEVSupervisionHead(TINY)
    boxes = torch.tensor([box_at(3.2, 3.2), box_at(3.2, 9.6)])
    found = head.assign_cells_to_boxes(boxes, *head.cells(boxes))
    learned = {(int(cell) // COUNT, int(cell) % COUNT): int(box) for cell, box in zip(*found, strict=True)}
    assert len(found.queries) == len(learned) == 12
    assert learned == {(row, column): int(column > 8) for row in (7, 8, 9) for column in (7, 8, 9, 10)}


@pytest.mark.parametrize(("side_m", "spread"), [(1.0, 0.7), (32.0, 0.25 * 32 / 6.4)])
def test_the_heatmap_is_as_wide_as_a_quarter_of_the_lesser_side(head, side_m, spread):
    """CornerNet's loss of scores of a half, cell by cell."""
    losses = losses_where_the_head_says(head, says_nothing(), [box_at(1.0, 1.0, 60.0, side_m)], [2])
    quarter_log = 0.25 * math.log(2)
    expected = (NUM_CLASSES - 1) * COUNT**2 * quarter_log
    for row in range(COUNT):
        for column in range(COUNT):
            target = math.exp(-((row - 8) ** 2 + (column - 8) ** 2) / (2 * spread**2))
            expected += quarter_log if target == 1 else (1 - target) ** 4 * quarter_log
    assert losses["heatmap_bev"] == pytest.approx(expected, rel=1e-4)


def test_a_frame_without_objects_teaches_that_there_are_none(head):
    losses = losses_where_the_head_says(head, says_nothing(), [], [])
    assert losses["box_bev"] == 0
    assert losses["heatmap_bev"] == pytest.approx(NUM_CLASSES * COUNT**2 * 0.25 * math.log(2), rel=1e-4)
