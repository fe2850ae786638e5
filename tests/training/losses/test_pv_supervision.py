"""Tests of the PV supervision, against points projected by hand and loops over the equations."""

import math

import numpy as np
import pytest
import torch

from duospacenet.model.duospacenet import FrameFeatures
from duospacenet.training.losses.pv_supervision import (
    PVSupervisionHead,
    assign_cells_to_peaks,
    find_peaks,
    focal_lengths,
    size_and_yaw,
)
from tests.helpers.trainings import TINY, synthetic_training_frames

SIZE = (8, 20)  # cells of 8 pixels in the tiny model's 160x64 images
NUM_CLASSES = len(TINY.classes)
# image_T_ego of a camera at the ego's origin that looks along x, with a focal length of 100 px and the principal point
# at (80, 32); and of a camera that looks the other way.
FRONT = torch.tensor([[80.0, -100, 0, 0], [32, 0, -100, 0], [1, 0, 0, 0]])
BACK = torch.tensor([[-80.0, 100, 0, 0], [-32, 0, -100, 0], [-1, 0, 0, 0]])


def box_at(x, y, z, height=1.0):
    return [x, y, z, 1.0, 1.0, height, 0.0, 0.0, 0.0]


def peaks_of(boxes, *cameras, valid=None):
    image_T_ego = torch.stack(cameras)
    camera_valid = torch.ones(len(cameras), dtype=torch.bool) if valid is None else torch.tensor(valid)
    return find_peaks(TINY, torch.tensor(boxes), image_T_ego, camera_valid, SIZE)


def losses_of(maps, boxes, labels, camera):
    """The losses of a frame of one camera with these boxes for these maps (1, classes + 8, H, W)."""
    (frame,) = synthetic_training_frames(1, 1)
    rig = {"image_T_ego": camera[None], "camera_valid": torch.ones(1, dtype=torch.bool)}
    ground_truth = {"boxes": torch.tensor(boxes), "labels": torch.tensor(labels)}
    losses = PVSupervisionHead(TINY).losses(maps, frame._replace(**rig, **ground_truth))
    return {name: float(loss) for name, loss in losses.items()}


def zero_maps():
    return torch.zeros(1, NUM_CLASSES + 8, *SIZE)


# --- Peaks --------------------------------------------------------------------------------------------------------


def test_a_peak_is_in_the_cell_of_the_projected_centre():
    """10 m ahead, 2 m left and 1 m up: at u = 80 - 100·2/10 = 60 and v = 32 - 100·1/10 = 22, so in cell (2, 7)."""
    peaks = peaks_of([box_at(10.0, 2.0, 1.0)], FRONT)
    assert [field.tolist() for field in peaks] == [[0], [2], [7], [[60 / 8, 22 / 8]], [0], [10.0]]


def test_a_camera_has_peaks_for_the_objects_in_front_of_it_and_inside_its_image():
    """Box 1 is 90 px left of the centre, outside. Box 2 is in front of the second camera, at u = 80 + 100·1/5."""
    boxes = [box_at(20.0, 0.0, 0.0), box_at(10.0, 9.0, 0.0), box_at(-5.0, 1.0, 0.0)]
    peaks = peaks_of(boxes, FRONT, BACK)
    assert peaks.camera.tolist() == [0, 1]
    assert peaks.box.tolist() == [0, 2]
    assert peaks.column.tolist() == [10, 12]
    assert peaks.depth_m.tolist() == [20.0, 5.0]


def test_a_lost_camera_has_no_peaks():
    assert peaks_of([box_at(10.0, 0.0, 0.0)], FRONT, FRONT, valid=[False, True]).camera.tolist() == [1]


def test_the_depth_is_measured_along_the_optical_axis():
    """A camera 1 m in front of the ego, turned 30 degrees to the left. The point is 12 m along its optical axis."""
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
def test_the_vertical_focal_length_is_found_for_any_rotation_of_the_camera(skew):
    generator = np.random.default_rng(0)
    rotation = np.linalg.qr(generator.normal(size=(3, 3)))[0]
    intrinsics = np.array([[90.0, skew, 70], [0, 130.0, 40], [0, 0, 1]])
    cameras = np.stack([intrinsics @ np.c_[np.eye(3), [1, 2, 3]], intrinsics @ np.c_[rotation, [4, 5, 6]]])
    assert focal_lengths(torch.from_numpy(cameras)).tolist() == pytest.approx([130.0, 130.0])


# --- Losses -------------------------------------------------------------------------------------------------------


def test_the_standard_deviation_of_a_peak_is_a_quarter_of_the_apparent_height():
    """10 m away and 6.4 m high: 64 pixels or 8 cells, so a standard deviation of 2 cells. The expected loss is a loop
    over CornerNet's equation, for scores of 0.5.
    """
    losses = losses_of(zero_maps(), [box_at(10.0, 0.0, 0.0, height=6.4)], [3], FRONT)
    quarter_log = 0.25 * math.log(2)  # 0.5² · -log 0.5
    expected = (NUM_CLASSES - 1) * SIZE[0] * SIZE[1] * quarter_log
    for row in range(SIZE[0]):
        for column in range(SIZE[1]):
            target = math.exp(-((row - 4) ** 2 + (column - 10) ** 2) / (2 * 2**2))
            expected += quarter_log if target == 1 else (1 - target) ** 4 * quarter_log
    assert losses["heatmap_pv"] == pytest.approx(expected, rel=1e-4)


def test_the_peak_of_a_small_object_covers_the_neighbouring_cells():
    """A standard deviation of 0.7 cells: the loss next to the peak is weighted by (1 - exp(-1 / 0.98))^4."""
    maps = zero_maps()
    maps[:, :NUM_CLASSES] = -100.0
    beside = maps.clone()
    beside[0, 0, 4, 11] = 0.0
    with_neighbour, without = (
        losses_of(each, [box_at(50.0, 0.0, 0.0, height=0.5)], [0], FRONT)["heatmap_pv"] for each in (beside, maps)
    )
    expected = (1 - math.exp(-1 / 0.98)) ** 4 * 0.25 * math.log(2)
    assert with_neighbour - without == pytest.approx(expected, rel=1e-2)


@pytest.mark.parametrize("zoom", [1.0, 2.0])
def test_the_depth_target_is_the_logarithm_of_the_depth_over_the_focal_length_in_image_heights(zoom):
    """Depths of 10 and 20 m, a focal length of 100 or 200 px, images 64 px high. The head predicts 1 in all cells."""
    camera = torch.diag(torch.tensor([zoom, zoom, 1.0])) @ FRONT
    camera[:2] += (1 - zoom) * torch.tensor([[80.0], [32.0]]) * camera[2]  # keeps the principal point
    maps = zero_maps()
    maps[:, NUM_CLASSES] = 1.0
    boxes = [box_at(10.0, 3.0 / zoom, 0.0), box_at(20.0, -6.0 / zoom, 0.0)]
    expected = 2.0 * sum(abs(math.log(depth * 64 / (100 * zoom)) - 1) for depth in (10, 20)) / 2
    assert losses_of(maps, boxes, [0, 1], camera)["depth_pv"] == pytest.approx(expected, rel=1e-5)


def test_the_appearance_loss_compares_position_size_and_yaw_in_nine_cells():
    """A box 10 m ahead and 2 m left, at (7.5, 2.75) cells, 1 m wide, 2 m long and 3 m high. Its yaw of 1 is
    1 - atan(0.2) relative to the line of sight. Zero maps; each value has a weight of 0.5.
    """
    box = [10.0, 2.0, 1.0, 1.0, 2.0, 3.0, 1.0, 0.0, 0.0]
    yaw = 1.0 - math.atan(0.2)
    others = math.log(2) + math.log(3) + abs(math.sin(yaw)) + abs(math.cos(yaw))
    cells = [(row, column) for row in (1, 2, 3) for column in (6, 7, 8)]
    total = sum(abs(7.5 - (column + 0.5)) + abs(2.75 - (row + 0.5)) + others for row, column in cells)
    losses = losses_of(zero_maps(), [box], [0], FRONT)
    assert losses["appearance_pv"] == pytest.approx(0.5 * total / 9, rel=1e-5)


def test_the_yaw_is_relative_to_the_line_of_sight_of_any_camera():
    """A camera 2 m in front of the ego that looks left. A box 5 m in front of it that heads left has a yaw of 0."""
    camera = torch.tensor([[100.0, 80, 0, -200], [0, 32, -100, 0], [0, 1, 0, 0]])
    peaks = peaks_of([box_at(2.0, 5.0, 0.0)], camera)
    (frame,) = synthetic_training_frames(1, 1)
    box = torch.tensor([[2.0, 5.0, 0, 1, 1, 1, math.pi / 2, 0, 0]])
    values = size_and_yaw(peaks, frame._replace(boxes=box, image_T_ego=camera[None]))
    assert values[0].tolist() == pytest.approx([0, 0, 0, 0, 1], abs=1e-5)


def test_a_cell_around_two_peaks_is_assigned_to_the_nearer_object_of_its_camera():
    """Objects at 20 m in column 10 and at 10 m in column 11: of the twelve cells, the nearer object gets its nine."""
    boxes = [box_at(20.0, 0.0, 0.0), box_at(10.0, -1.0, 0.0), box_at(-30.0, 0.0, 0.0)]
    cell, peak = assign_cells_to_peaks(peaks_of(boxes, FRONT, BACK), *SIZE)
    assigned = sorted(zip(peak.tolist(), cell.tolist(), strict=True))
    rows = (3, 4, 5)
    assert [c for p, c in assigned if p == 0] == [row * 20 + 9 for row in rows]
    assert [c for p, c in assigned if p == 1] == [row * 20 + column for row in rows for column in (10, 11, 12)]
    assert [c for p, c in assigned if p == 2] == [row * 20 + column for row in rows for column in (9, 10, 11)]


def test_a_new_head_gives_class_scores_of_about_0_01_and_can_be_trained_without_objects():
    head = PVSupervisionHead(TINY)
    maps = head(FrameFeatures([torch.zeros(6, TINY.channels, *SIZE)], None))
    assert maps.shape == (6, NUM_CLASSES + 8, *SIZE)
    assert maps[:, :NUM_CLASSES].sigmoid().mean().item() == pytest.approx(0.01, rel=0.1)
    (frame,) = synthetic_training_frames(1, 1)
    losses = head.losses(maps, frame._replace(boxes=frame.boxes[:0], labels=frame.labels[:0]))
    assert float(losses["depth_pv"].detach()) == float(losses["appearance_pv"].detach()) == 0
    assert 0 < float(losses["heatmap_pv"].detach()) < 100


def test_most_objects_of_a_synthetic_frame_have_a_peak_in_some_camera():
    """The ground truth contains visible objects only. The centre of a visible object is rarely outside the image."""
    (frame,) = synthetic_training_frames(1, 1)
    peaks = find_peaks(TINY, frame.boxes, frame.image_T_ego, frame.camera_valid, SIZE)
    assert len(peaks.box.unique()) > 0.8 * len(frame.boxes)


def test_in_a_flipped_image_the_yaw_is_that_of_the_mirrored_scene():
    """The same picture: a flipped image of the scene, and an image of the scene with left and right exchanged."""
    (frame,) = synthetic_training_frames(1, 1)
    boxes = torch.tensor([[10.0, 2.0, 1.0, 1.0, 1.0, 1.0, 0.4, 0.0, 0.0]])
    mirrored = boxes * torch.tensor([1.0, -1, 1, 1, 1, 1, -1, 1, -1])
    flip = torch.tensor([[-1.0, 0, 160], [0, 1, 0], [0, 0, 1]])
    of_flipped = frame._replace(boxes=boxes, image_T_ego=(flip @ FRONT)[None])
    of_mirrored = frame._replace(boxes=mirrored, image_T_ego=FRONT[None])
    peaks = peaks_of(boxes.tolist(), flip @ FRONT)
    assert peaks.position.tolist() == peaks_of(mirrored.tolist(), FRONT).position.tolist()
    torch.testing.assert_close(size_and_yaw(peaks, of_flipped), size_and_yaw(peaks, of_mirrored))
