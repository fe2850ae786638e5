"""Perspective supervision, against points projected by hand and loops over the equations."""

import math

import numpy as np
import pytest
import torch

from duospacenet.model.duospacenet import FrameFeatures
from duospacenet.training.pv_supervision import (
    Peaks,
    PVSupervisionHead,
    assign_cells_to_peaks,
    find_peaks,
    focal_lengths,
    size_and_yaw,
)
from tests.helpers.trainings import TINY, synthetic_training_frames

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


def losses_where_the_head_says(maps, boxes, labels, camera):
    """Of a frame that one camera saw. maps (1, classes + 8, H, W): what the head gives."""
    (sample,) = synthetic_training_frames(1, 1)
    rig = {"image_T_ego": camera[None], "camera_valid": torch.ones(1, dtype=torch.bool)}
    ground_truth = {"boxes": torch.tensor(boxes), "labels": torch.tensor(labels)}
    losses = PVSupervisionHead(TINY).losses(maps, sample._replace(**rig, **ground_truth))
    return {name: float(loss) for name, loss in losses.items()}


def says_nothing():
    return torch.zeros(1, NUM_CLASSES + 8, *SIZE)


# --- Peaks --------------------------------------------------------------------------------------------------------


def test_a_peak_lies_where_a_pinhole_shows_the_centre():
    """10 m ahead, 2 m left and 1 m up: at u = 80 - 100·2/10 = 60 and v = 32 - 100·1/10 = 22, so in cell (2, 7)."""
    peaks = peaks_of([box_at(10.0, 2.0, 1.0)], AHEAD)
    assert [field.tolist() for field in peaks] == [[0], [2], [7], [[60 / 8, 22 / 8]], [0], [10.0]]


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


# --- Losses -------------------------------------------------------------------------------------------------------


def test_the_head_learns_a_gaussian_as_wide_as_a_quarter_of_the_apparent_height():
    """10 m away, 6.4 m high: 64 pixels, 8 cells, so a standard deviation of 2. The loss by a loop over CornerNet's
    equation, for scores of a half everywhere.
    """
    losses = losses_where_the_head_says(says_nothing(), [box_at(10.0, 0.0, 0.0, height=6.4)], [3], AHEAD)
    quarter_log = 0.25 * math.log(2)  # 0.5² · -log 0.5
    expected = (NUM_CLASSES - 1) * SIZE[0] * SIZE[1] * quarter_log
    for row in range(SIZE[0]):
        for column in range(SIZE[1]):
            target = math.exp(-((row - 4) ** 2 + (column - 10) ** 2) / (2 * 2**2))
            expected += quarter_log if target == 1 else (1 - target) ** 4 * quarter_log
    assert losses["heatmap_pv"] == pytest.approx(expected, rel=1e-4)


def test_what_is_far_and_small_still_has_a_peak_with_neighbours():
    """A standard deviation of 0.7 cells: the four cells beside the peak count (1 - exp(-1 / 0.98))^4."""
    maps = says_nothing()
    maps[:, :NUM_CLASSES] = -100.0
    beside = maps.clone()
    beside[0, 0, 4, 11] = 0.0
    near, none = (
        losses_where_the_head_says(says, [box_at(50.0, 0.0, 0.0, height=0.5)], [0], AHEAD)["heatmap_pv"]
        for says in (beside, maps)
    )
    assert near - none == pytest.approx((1 - math.exp(-1 / 0.98)) ** 4 * 0.25 * math.log(2), rel=1e-2)


@pytest.mark.parametrize("zoom", [1.0, 2.0])
def test_the_head_learns_the_logarithm_of_the_depth_in_focal_lengths(zoom):
    """10 and 20 m before a lens of 100 or 200 pixels, pictures 64 pixels high; the head says 1 in all nine cells."""
    camera = torch.diag(torch.tensor([zoom, zoom, 1.0])) @ AHEAD
    camera[:2] += (1 - zoom) * torch.tensor([[80.0], [32.0]]) * camera[2]  # the middle stays where it was
    maps = says_nothing()
    maps[:, NUM_CLASSES] = 1.0
    boxes = [box_at(10.0, 3.0 / zoom, 0.0), box_at(20.0, -6.0 / zoom, 0.0)]
    expected = 2.0 * sum(abs(math.log(depth * 64 / (100 * zoom)) - 1) for depth in (10, 20)) / 2
    assert losses_where_the_head_says(maps, boxes, [0, 1], camera)["depth_pv"] == pytest.approx(expected, rel=1e-5)


def test_the_head_learns_where_the_centre_is_and_how_the_object_appears():
    """A box 10 m ahead and 2 m left, at (7.5, 2.75) cells, 1 m wide, 2 m long, 3 m high, with a yaw of 1: from the
    line of sight on, 1 - atan(0.2). Nine cells say nothing; each number counts a half.
    """
    box = [10.0, 2.0, 1.0, 1.0, 2.0, 3.0, 1.0, 0.0, 0.0]
    yaw = 1.0 - math.atan(0.2)
    look = math.log(2) + math.log(3) + abs(math.sin(yaw)) + abs(math.cos(yaw))
    total = sum(abs(7.5 - (column + 0.5)) + abs(2.75 - (row + 0.5)) + look for row in (1, 2, 3) for column in (6, 7, 8))
    losses = losses_where_the_head_says(says_nothing(), [box], [0], AHEAD)
    assert losses["appearance_pv"] == pytest.approx(0.5 * total / 9, rel=1e-5)


def test_the_yaw_is_told_from_the_line_of_sight_of_a_camera_that_is_turned_and_moved():
    """A camera 2 m ahead of the ego, looking left; what stands 5 m before it and points to the left too is seen from
    behind: a yaw of 0.
    """
    camera = torch.tensor([[100.0, 80, 0, -200], [0, 32, -100, 0], [0, 1, 0, 0]])
    peaks = peaks_of([box_at(2.0, 5.0, 0.0)], camera)
    (sample,) = synthetic_training_frames(1, 1)
    box = torch.tensor([[2.0, 5.0, 0, 1, 1, 1, math.pi / 2, 0, 0]])
    seen = size_and_yaw(peaks, sample._replace(boxes=box, image_T_ego=camera[None]))
    assert seen[0].tolist() == pytest.approx([0, 0, 0, 0, 1], abs=1e-5)


def test_a_cell_around_two_peaks_tells_of_the_nearer_object_in_its_own_camera():
    """At 20 m in column 10 and at 10 m in column 11: of the twelve cells, the nine of the nearer are its own."""
    boxes = [box_at(20.0, 0.0, 0.0), box_at(10.0, -1.0, 0.0), box_at(-30.0, 0.0, 0.0)]
    cell, peak = assign_cells_to_peaks(peaks_of(boxes, AHEAD, BACK), *SIZE)
    told = sorted(zip(peak.tolist(), cell.tolist(), strict=True))
    rows = (3, 4, 5)
    assert [c for p, c in told if p == 0] == [row * 20 + 9 for row in rows]
    assert [c for p, c in told if p == 1] == [row * 20 + column for row in rows for column in (10, 11, 12)]
    assert [c for p, c in told if p == 2] == [row * 20 + column for row in rows for column in (9, 10, 11)]


def test_a_new_head_gives_every_class_about_a_hundredth_and_learns_without_objects():
    head = PVSupervisionHead(TINY)
    maps = head(FrameFeatures([torch.zeros(6, TINY.channels, *SIZE)], None))
    assert maps.shape == (6, NUM_CLASSES + 8, *SIZE)
    assert maps[:, :NUM_CLASSES].sigmoid().mean().item() == pytest.approx(0.01, rel=0.1)
    (sample,) = synthetic_training_frames(1, 1)
    nothing = head.losses(maps, sample._replace(boxes=sample.boxes[:0], labels=sample.labels[:0]))
    assert float(nothing["depth_pv"].detach()) == float(nothing["appearance_pv"].detach()) == 0
    assert 0 < float(nothing["heatmap_pv"].detach()) < 100


def test_of_a_drawn_frame_every_object_is_seen_by_some_camera():
    """Its truth holds what cameras see; a centre may lie beside the picture, but hardly ever does."""
    (sample,) = synthetic_training_frames(1, 1)
    peaks: Peaks = find_peaks(TINY, sample.boxes, sample.image_T_ego, sample.camera_valid, SIZE)
    assert len(peaks.box.unique()) > 0.8 * len(sample.boxes)
