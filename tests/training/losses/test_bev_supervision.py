"""Tests of the BEV supervision, against cells and distances worked by hand and in loops."""

import math

import pytest
import torch

from duospacenet.model.duospacenet import FrameFeatures
from duospacenet.training.losses.bev_supervision import BEVSupervisionHead
from tests.helpers.trainings import TINY, synthetic_training_frames

NUM_CLASSES = len(TINY.classes)
COUNT, CELL_M, LOWER_M = 16, 6.4, -51.2  # the tiny model's grid


@pytest.fixture
def head():
    return BEVSupervisionHead(TINY)


def box_at(x, y, width=1.0, length=1.0):
    return [x, y, 1.0, width, length, 1.5, 0.0, 2.0, 3.0]


def losses_of(head, maps, boxes, labels):
    """The losses of a frame with these boxes for these maps (1, classes + 10, X, Y)."""
    (frame,) = synthetic_training_frames(1, 1)
    ground_truth = {"boxes": torch.tensor(boxes).reshape(-1, 9), "labels": torch.tensor(labels, dtype=torch.long)}
    return {name: float(loss) for name, loss in head.losses(maps, frame._replace(**ground_truth)).items()}


def zero_maps():
    return torch.zeros(1, NUM_CLASSES + 10, COUNT, COUNT)


def test_the_row_of_a_cell_follows_from_x_and_the_column_from_y(head):
    """Cells of 6.4 m from -51.2 m: x = -51.2 + 6.4 · 3.5 is in row 3, and y = 50 in column 15. A border belongs to the
    next cell, the last border to the last cell.
    """
    boxes = torch.tensor([box_at(-28.8, 50.0), box_at(0.0, -51.2), box_at(51.2, 51.2)])
    row, column = head.cells(boxes)
    assert row.tolist() == [3, 8, 15]
    assert column.tolist() == [15, 0, 15]


def test_the_box_loss_is_the_mean_distance_over_nine_cells(head):
    """0.25 · weighted L1, with weights (2, 2, 2, 1, ...). Zero maps predict the centres of their own cells."""
    x, y = -20.0, 13.0
    losses = losses_of(head, zero_maps(), [box_at(x, y, 2.0, 4.0)], [0])
    others = 2 * 1.0 + math.log(2) + math.log(4) + math.log(1.5) + 0.0 + 1.0 + 2.0 + 3.0
    row, column = 4, 10  # (51.2 - 20) / 6.4 = 4.9; (51.2 + 13) / 6.4 = 10.03
    total = 0.0
    for i in (row - 1, row, row + 1):
        for j in (column - 1, column, column + 1):
            distance = abs(LOWER_M + (i + 0.5) * CELL_M - x) + abs(LOWER_M + (j + 0.5) * CELL_M - y)
            total += 2 * distance + others
    assert losses["box_bev"] == pytest.approx(0.25 * total / 9, rel=1e-5)


def test_predicted_positions_are_relative_to_the_centre_of_the_cell(head):
    """The centre of cell (8, 8) is (3.2, 3.2) m and the object is at (1, 1). Only this cell predicts the offset."""
    maps = zero_maps()
    before = losses_of(head, maps, [box_at(1.0, 1.0)], [0])["box_bev"]
    maps[0, NUM_CLASSES : NUM_CLASSES + 2, 8, 8] = torch.tensor([-2.2, -2.2])
    after = losses_of(head, maps, [box_at(1.0, 1.0)], [0])["box_bev"]
    assert before - after == pytest.approx(0.25 * 2 * (2.2 + 2.2) / 9, rel=1e-4)


def test_the_head_gives_logits_and_pose_vectors_on_the_grid(head):
    bev = torch.zeros(1, TINY.channels, COUNT, COUNT)
    assert head(FrameFeatures([], bev)).shape == (1, NUM_CLASSES + 10, COUNT, COUNT)


def test_a_cell_between_two_objects_is_assigned_to_the_nearer(head):
    """The objects are at the centres of the cells (8, 8) and (8, 9). Of the twelve cells around them, each object gets
    its own column and the one outside.
    """
    boxes = torch.tensor([box_at(3.2, 3.2), box_at(3.2, 9.6)])
    assignment = head.assign_cells_to_boxes(boxes, *head.cells(boxes))
    assigned = {(int(cell) // COUNT, int(cell) % COUNT): int(box) for cell, box in zip(*assignment, strict=True)}
    assert len(assignment.queries) == len(assigned) == 12
    assert assigned == {(row, column): int(column > 8) for row in (7, 8, 9) for column in (7, 8, 9, 10)}


@pytest.mark.parametrize(("side_m", "spread"), [(1.0, 0.7), (32.0, 0.25 * 32 / 6.4)])
def test_the_standard_deviation_of_a_peak_is_a_quarter_of_the_shorter_side(head, side_m, spread):
    """CornerNet's loss for scores of 0.5, in a loop over the cells."""
    losses = losses_of(head, zero_maps(), [box_at(1.0, 1.0, 60.0, side_m)], [2])
    quarter_log = 0.25 * math.log(2)
    expected = (NUM_CLASSES - 1) * COUNT**2 * quarter_log
    for row in range(COUNT):
        for column in range(COUNT):
            target = math.exp(-((row - 8) ** 2 + (column - 8) ** 2) / (2 * spread**2))
            expected += quarter_log if target == 1 else (1 - target) ** 4 * quarter_log
    assert losses["heatmap_bev"] == pytest.approx(expected, rel=1e-4)


def test_a_frame_without_objects_trains_the_heatmaps_only(head):
    losses = losses_of(head, zero_maps(), [], [])
    assert losses["box_bev"] == 0
    assert losses["heatmap_bev"] == pytest.approx(NUM_CLASSES * COUNT**2 * 0.25 * math.log(2), rel=1e-4)
