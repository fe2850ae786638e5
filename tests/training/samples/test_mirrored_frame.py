"""Tests of mirrored frames: images, calibrations, poses, boxes and maps are mirrored together."""

from dataclasses import replace

import numpy as np

from duospacenet.runtime import Camera
from duospacenet.runtime.frame import GroundTruth
from duospacenet.runtime.geometry import box_corners, image_T_ego, inverse, project, rigid_transform, rotation_z
from duospacenet.runtime.validation import check_frame
from duospacenet.training.samples.mirrored_frame import mirror_frame, mirror_ground_truth
from tests.helpers.trainings import synthetic_frames

TO_RIGHT = np.array([1.0, -1.0, 1.0])  # mirrors a point of the ego frame


def first_frame():
    (frame,) = synthetic_frames(1, 1)
    return frame


def test_a_mirrored_frame_is_valid_and_mirrored_twice_it_is_the_frame():
    frame = first_frame()
    mirrored = mirror_frame(frame)
    check_frame(mirrored, len(frame.cameras))
    again = mirror_frame(mirrored)
    np.testing.assert_allclose(again.global_T_ego, frame.global_T_ego)
    np.testing.assert_array_equal(again.ground_truth.boxes, frame.ground_truth.boxes)
    for name, camera in frame.cameras.items():
        np.testing.assert_array_equal(again.images[name], frame.images[name])
        np.testing.assert_allclose(again.cameras[name].intrinsics_px, camera.intrinsics_px)
        np.testing.assert_allclose(again.cameras[name].camera_T_ego, camera.camera_T_ego)


def test_a_mirrored_point_is_at_the_flipped_pixel_of_every_camera():
    """Points around the rig. A pixel at x is at width - x in the flipped image, at the same depth."""
    frame = first_frame()
    skew_px = np.array([[0, 3, 0], [0, 0, 0], [0, 0, 0]])
    skewed = {
        name: replace(camera, intrinsics_px=camera.intrinsics_px + skew_px) for name, camera in frame.cameras.items()
    }
    frame = replace(frame, cameras=skewed)
    mirrored = mirror_frame(frame)
    points = np.random.default_rng(0).uniform([-30, -30, -1], [30, 30, 3], (50, 3))
    for name, camera in frame.cameras.items():
        other = mirrored.cameras[name]
        before, depth_m = project(points, image_T_ego(camera.intrinsics_px, camera.camera_T_ego))
        after, depth_after_m = project(points * TO_RIGHT, image_T_ego(other.intrinsics_px, other.camera_T_ego))
        np.testing.assert_allclose(depth_after_m, depth_m)
        visible = depth_m > 1
        assert visible.any()
        np.testing.assert_allclose(after[visible, 0], camera.width_px - before[visible, 0])
        np.testing.assert_allclose(after[visible, 1], before[visible, 1])
        np.testing.assert_array_equal(mirrored.images[name], frame.images[name][:, ::-1])


def test_a_mirrored_camera_worked_by_hand():
    """A camera 1 m left of the ego's origin that looks along x: mirrored, it is 1 m to the right."""
    intrinsics = np.array([[100.0, 0, 70], [0, 100, 30], [0, 0, 1]])
    camera_T_ego = np.array([[0.0, -1, 0, 1], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
    frame = replace(first_frame(), cameras={"A": Camera(intrinsics, camera_T_ego, 160, 64)}, images={"A": None})
    camera = mirror_frame(frame).cameras["A"]
    assert camera.intrinsics_px.tolist() == [[100, 0, 90], [0, 100, 30], [0, 0, 1]]
    assert inverse(camera.camera_T_ego)[:3, 3].tolist() == [0, -1, 0]
    assert mirror_frame(frame).images == {"A": None}


def test_a_mirrored_box_keeps_yaw_and_velocity_consistent():
    """At 3 m to the left, turned 0.3 rad to the left, driving along its heading at 5 m/s. Box 2 has no velocity."""
    velocity = 5 * np.cos(0.3), 5 * np.sin(0.3)
    boxes = np.array([[10, 3, 1, 2, 4, 1.5, 0.3, *velocity], [8, -2, 1, 2, 4, 1.5, -3, np.nan, np.nan]])
    truth = GroundTruth(boxes, ("car", "bus"))
    mirrored = mirror_ground_truth(truth)
    expected = [10, -3, 1, 2, 4, 1.5, -0.3, 5 * np.cos(0.3), -5 * np.sin(0.3)]
    np.testing.assert_allclose(mirrored.boxes[0], expected)
    assert np.isnan(mirrored.boxes[1, 7:]).all()
    np.testing.assert_array_equal(truth.boxes, boxes)
    assert mirrored.classes == truth.classes
    # Front left becomes front right, and so on: corners 0 1 2 3 are the mirrored corners 1 0 3 2.
    corners = box_corners(boxes)[:, [1, 0, 3, 2, 5, 4, 7, 6]] * TO_RIGHT
    np.testing.assert_allclose(box_corners(mirrored.boxes), corners)


def test_a_mirrored_mask_has_the_cell_on_the_other_side():
    """Of four columns, y = -1.5, -0.5, 0.5, 1.5: the cell in column 3 moves to column 0."""
    mask = np.zeros((3, 4), bool)
    mask[2, 3] = True
    mirrored = mirror_ground_truth(GroundTruth(np.zeros((0, 9)), (), {"drivable_area": mask}, has_boxes=False))
    assert np.argwhere(mirrored.maps["drivable_area"]).tolist() == [[2, 0]]
    assert not mirrored.has_boxes


def test_the_ego_motion_between_mirrored_frames_is_mirrored():
    """Between two frames the ego moves 2 m forward and 1 m left and turns 90 degrees to the left."""
    start = rigid_transform(rotation_z(0.7), [100, 50, 3])
    past, now = first_frame(), first_frame()
    past = replace(past, global_T_ego=start)
    now = replace(now, global_T_ego=start @ rigid_transform(rotation_z(np.pi / 2), [2, 1, 0]))
    past_T_now = inverse(mirror_frame(past).global_T_ego) @ mirror_frame(now).global_T_ego
    np.testing.assert_allclose(past_T_now, rigid_transform(rotation_z(-np.pi / 2), [2, -1, 0]), atol=1e-12)
