"""Image motion: points at rest, seen by cameras of known geometry, agree with the right calibration only."""

import numpy as np
import pytest

from duospacenet.rig.image_directions import ImageDirections
from duospacenet.rig.image_features import Features
from duospacenet.rig.image_motion import ImageMotion
from duospacenet.rig.image_overlaps import ImageOverlaps
from duospacenet.runtime.frame import Frame
from duospacenet.runtime.geometry import image_T_ego, inverse, project, rigid_transform
from tests.helpers.rigs import HEIGHT_PX, WIDTH_PX, level_camera, mount_position

CAMERAS = {"LEFT": level_camera(80, mount_position(90)), "RIGHT": level_camera(-80, mount_position(-90))}
POINTS_M = np.random.default_rng(0).uniform((-25, -25, 0), (25, 25, 6), (3000, 3))


def frame_at(x_m, scene="scene"):
    return Frame(dict.fromkeys(CAMERAS), CAMERAS, rigid_transform(np.eye(3), [x_m, 0, 0]), x_m / 8, scene)


def features_at(x_m, names):
    """The points as features of cameras. Point k has the descriptor k. names: the camera that takes each image."""
    found = {}
    for name, taken_by in names.items():
        camera = CAMERAS[taken_by]
        ego = POINTS_M - (x_m, 0, 0)
        pixels, depth_m = project(ego, image_T_ego(camera.intrinsics_px, camera.camera_T_ego))
        seen = (depth_m > 1) & (pixels >= 0).all(axis=1) & (pixels < (WIDTH_PX, HEIGHT_PX)).all(axis=1)
        descriptors = np.random.default_rng(1).normal(size=(len(POINTS_M), 128)).astype(np.float32)
        descriptors /= np.linalg.norm(descriptors, axis=1, keepdims=True)
        found[name] = Features(pixels[seen], descriptors[seen])
    return found


def motion_of(step_m=3.0, names=None):
    names = names or {name: name for name in CAMERAS}
    motion = ImageMotion()
    motion.add(frame_at(0), frame_at(step_m), (features_at(0, names), features_at(step_m, names)))
    return motion


def test_points_at_rest_agree_with_the_right_calibration_and_not_with_a_turned_one():
    motion = motion_of()
    for name in CAMERAS:
        agreeing, moving = motion.count(name)
        assert agreeing == moving > 50
        assert motion.count(name, yaw_deg=25).agreeing < 0.6 * moving
        assert motion.count(name, yaw_deg=180).agreeing == 0


def test_exchanged_images_agree_with_the_calibration_of_the_other_camera():
    motion = motion_of(names={"LEFT": "RIGHT", "RIGHT": "LEFT"})
    for name, other in (("LEFT", "RIGHT"), ("RIGHT", "LEFT")):
        assert motion.count(name).agreeing == 0
        assert motion.count(name, calibration_of=other).agreeing == motion.count(name, calibration_of=other).moving > 50


@pytest.mark.parametrize("step_m", [0.0, 0.3, 9.0])
def test_frames_that_are_too_near_or_too_far_apart_are_not_compared(step_m):
    assert motion_of(step_m).cameras == []


def test_inverted_poses_do_not_agree():
    names = {name: name for name in CAMERAS}
    before, after = frame_at(0), frame_at(3.0)
    backward = Frame(after.images, after.cameras, inverse(after.global_T_ego), after.timestamp_s, after.scene)
    motion = ImageMotion()
    motion.add(before, backward, (features_at(0, names), features_at(3.0, names)))
    assert motion.count("LEFT").agreeing == 0


def test_details_that_move_although_the_pose_is_constant_are_a_finding():
    names = {name: name for name in CAMERAS}
    motion = ImageMotion()
    for step in range(4):
        motion.add(frame_at(0), frame_at(0), (features_at(3.0 * step, names), features_at(3.0 * step + 3, names)))
    (finding,) = ImageDirections(ImageOverlaps(), motion, CAMERAS).drive_findings()
    assert finding.subject == "ego pose"
    assert "one pose was given" in finding.cause


def test_a_parked_vehicle_has_no_finding():
    names = {name: name for name in CAMERAS}
    motion = ImageMotion()
    for _ in range(4):
        motion.add(frame_at(0), frame_at(0), (features_at(0, names), features_at(0, names)))
    assert motion.at_rest.agreeing > 200
    assert ImageDirections(ImageOverlaps(), motion, CAMERAS).drive_findings() == []
