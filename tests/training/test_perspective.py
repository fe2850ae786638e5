"""Perspective supervision, against points projected by hand and loops over the equations."""

import math

import numpy as np
import pytest
import torch
from trainings import TINY, drawn_samples

from duospacenet.training.perspective import (
    Peaks,
    PerspectiveHead,
    draw_heatmaps,
    find_peaks,
    focal_lengths,
    heatmap_loss,
)

SIZE = (8, 20)  # cells of 8 pixels in the tiny model's 160x64 images
NUM_CLASSES = len(TINY.classes)
# The ego's x ahead, y left, z up to the camera's right, down, ahead: a camera in the origin that looks along x, with a
# focal length of 100 pixels and the middle of the image at (80, 32).
AHEAD = torch.tensor([[80.0, -100, 0, 0], [32, 0, -100, 0], [1, 0, 0, 0]])
BACK = torch.tensor([[-80.0, 100, 0, 0], [-32, 0, -100, 0], [-1, 0, 0, 0]])


def box_at(x, y, z, height=1.0):
    return [x, y, z, 1.0, 1.0, height, 0.0, 0.0, 0.0]


def peaks_of(boxes, *cameras, valid=None):
    rig = torch.stack(cameras)
    there = torch.ones(len(cameras), dtype=torch.bool) if valid is None else torch.tensor(valid)
    return find_peaks(TINY, torch.tensor(boxes), rig, there, SIZE)


def heatmaps(boxes, labels):
    boxes, rig = torch.tensor(boxes), AHEAD[None]
    peaks = find_peaks(TINY, boxes, rig, torch.ones(1, dtype=torch.bool), SIZE)
    return draw_heatmaps(TINY, torch.Size((1, NUM_CLASSES, *SIZE)), peaks, boxes, torch.tensor(labels), rig)[0]


# --- Peaks --------------------------------------------------------------------------------------------------------


def test_a_peak_lies_where_a_pinhole_shows_the_centre():
    """10 m ahead, 2 m left and 1 m up: at u = 80 - 100·2/10 = 60 and v = 32 - 100·1/10 = 22, so in cell (2, 7)."""
    peaks = peaks_of([box_at(10.0, 2.0, 1.0)], AHEAD)
    assert [field.tolist() for field in peaks] == [[0], [2], [7], [0], [10.0]]


def test_each_camera_shows_what_lies_before_it_and_inside_its_picture():
    """2: 90 px left of the middle, outside; 3: behind the first camera, before the second, at u = 80 + 100·1/5."""
    boxes = [box_at(20.0, 0.0, 0.0), box_at(10.0, 9.0, 0.0), box_at(-5.0, 1.0, 0.0)]
    peaks = peaks_of(boxes, AHEAD, BACK)
    assert peaks.camera.tolist() == [0, 1]
    assert peaks.box.tolist() == [0, 2]
    assert peaks.column.tolist() == [10, 12]
    assert peaks.depth_m.tolist() == [20.0, 5.0]


def test_a_lost_camera_shows_nothing():
    assert peaks_of([box_at(10.0, 0.0, 0.0)], AHEAD, AHEAD, valid=[False, True]).camera.tolist() == [1]


def test_the_depth_is_along_the_optical_axis_of_a_camera_that_is_turned_and_moved():
    """30 degrees to the left, mounted 1 m ahead: the way to the point, on the axis."""
    turn = math.radians(30)
    ahead, left = np.array([math.cos(turn), math.sin(turn), 0]), np.array([-math.sin(turn), math.cos(turn), 0])
    rotation = np.stack([-left, [0, 0, -1], ahead])
    centre = np.array([1.0, 0, 0])
    intrinsics = np.array([[100, 0, 80], [0, 100, 32], [0, 0, 1]])
    camera = torch.from_numpy(intrinsics @ np.c_[rotation, -rotation @ centre]).float()
    point = centre + 12 * ahead + 3 * left
    peaks = peaks_of([box_at(*point.tolist())], camera)
    assert peaks.depth_m.tolist() == pytest.approx([12.0], rel=1e-5)
    assert peaks.column.tolist() == [int((80 - 100 * 3 / 12) / 8)]


@pytest.mark.parametrize("skew", [0.0, 0.5])
def test_the_focal_length_of_a_turned_camera_is_its_vertical_one(skew):
    generator = np.random.default_rng(0)
    rotation = np.linalg.qr(generator.normal(size=(3, 3)))[0]
    intrinsics = np.array([[90.0, skew, 70], [0, 130.0, 40], [0, 0, 1]])
    cameras = np.stack([intrinsics @ np.c_[np.eye(3), [1, 2, 3]], intrinsics @ np.c_[rotation, [4, 5, 6]]])
    assert focal_lengths(torch.from_numpy(cameras)).tolist() == pytest.approx([130.0, 130.0])


# --- Heatmaps -----------------------------------------------------------------------------------------------------


def test_a_heatmap_is_a_gaussian_as_wide_as_a_quarter_of_the_apparent_height():
    """10 m away, 6.4 m high: 64 pixels, 8 cells, so a standard deviation of 2."""
    drawn = heatmaps([box_at(10.0, 0.0, 0.0, height=6.4)], [3])
    for row in range(SIZE[0]):
        for column in range(SIZE[1]):
            expected = math.exp(-((row - 4) ** 2 + (column - 10) ** 2) / (2 * 2**2))
            assert float(drawn[3, row, column]) == pytest.approx(expected, rel=1e-4, abs=1e-9)
    assert drawn[3, 4, 10] == 1
    assert drawn[3, 2, 10] == drawn[3, 6, 10] == drawn[3, 4, 8] == drawn[3, 4, 12]
    assert not drawn[[label for label in range(NUM_CLASSES) if label != 3]].any()


def test_what_is_far_and_small_still_has_a_peak_with_neighbours():
    drawn = heatmaps([box_at(50.0, 0.0, 0.0, height=0.5)], [0])
    assert drawn[0, 4, 10] == 1
    assert float(drawn[0, 4, 11]) == pytest.approx(math.exp(-1 / (2 * 0.7**2)), rel=1e-4)


def test_where_two_objects_of_a_class_overlap_the_nearer_peak_counts_and_other_classes_stay_apart():
    near, beside = box_at(10.0, 0.0, 0.0, height=6.4), box_at(10.0, 2.4, 0.0, height=6.4)
    alone, other = heatmaps([near], [3]), heatmaps([beside], [3])
    assert torch.equal(heatmaps([near, beside], [3, 3]), torch.maximum(alone, other))
    apart = heatmaps([near, beside], [3, 4])
    assert torch.equal(apart[3], alone[3])
    assert torch.equal(apart[4], other[3])


# --- Losses -------------------------------------------------------------------------------------------------------


def test_the_heatmap_loss_is_cornernets():
    """Law and Deng, 2018, eq. 1, α = 2 and β = 4, cell by cell in float64."""
    generator = torch.Generator().manual_seed(0)
    logits = torch.randn(2, 3, 4, 5, generator=generator) * 2
    targets = torch.rand(2, 3, 4, 5, generator=generator)
    targets[0, 1, 2, 3] = targets[1, 0, 0, 0] = 1.0
    total = 0.0
    for logit, target in zip(logits.flatten().tolist(), targets.flatten().tolist(), strict=True):
        score = 1 / (1 + math.exp(-logit))
        if target == 1:
            total -= (1 - score) ** 2 * math.log(score)
        else:
            total -= (1 - target) ** 4 * score**2 * math.log(1 - score)
    assert float(heatmap_loss(logits, targets)) == pytest.approx(total / 2, rel=1e-5)


def test_without_a_peak_the_heatmap_loss_is_a_sum():
    assert float(heatmap_loss(torch.zeros(1, 1, 2, 2), torch.zeros(1, 1, 2, 2))) == pytest.approx(math.log(2))


def test_the_head_learns_the_logarithm_of_the_depth_in_the_cells_of_the_peaks(monkeypatch):
    """Depths of 10 and 20 m; the head says 1 everywhere."""
    head = PerspectiveHead(TINY)
    says = torch.zeros(1, NUM_CLASSES, *SIZE), torch.ones(1, *SIZE)
    monkeypatch.setattr(head, "forward", lambda pv: says)
    boxes, labels = torch.tensor([box_at(10.0, 0.0, 0.0), box_at(20.0, 3.0, 0.0)]), torch.tensor([0, 1])
    losses = head.losses(torch.zeros(1, TINY.channels, *SIZE), AHEAD[None], torch.ones(1, dtype=bool), boxes, labels)
    expected = 0.5 * (math.log(10) - 1 + math.log(20) - 1) / 2
    assert float(losses["depth"]) == pytest.approx(expected, rel=1e-5)


def test_a_new_head_gives_every_class_about_a_hundredth_and_learns_without_objects():
    head = PerspectiveHead(TINY)
    logits, _ = head(torch.zeros(6, TINY.channels, *SIZE))
    assert logits.sigmoid().mean().item() == pytest.approx(0.01, rel=0.1)
    (sample,) = drawn_samples(1, 1)
    pv = torch.zeros(6, TINY.channels, *SIZE)
    nothing = head.losses(pv, sample.image_T_ego, sample.camera_valid, sample.boxes[:0], sample.labels[:0])
    assert float(nothing["depth"].detach()) == 0
    assert 0 < float(nothing["heatmap"].detach()) < 100


def test_of_a_drawn_frame_every_object_is_seen_by_some_camera():
    """Its truth holds what cameras see; a centre may lie beside the picture, but hardly ever does."""
    (sample,) = drawn_samples(1, 1)
    peaks: Peaks = find_peaks(TINY, sample.boxes, sample.image_T_ego, sample.camera_valid, SIZE)
    assert len(peaks.box.unique()) > 0.8 * len(sample.boxes)
