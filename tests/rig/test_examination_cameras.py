"""Damage to one camera of a rig is found, with the right verdict and cause."""

import numpy as np
import pytest

from duospacenet.rig import Verdict
from duospacenet.runtime.geometry import inverse, rigid_transform, rotation_z
from tests.helpers.rigs import (
    change_extrinsics,
    change_intrinsics,
    examine_source,
    level_camera,
    mount_position,
    pitch,
    write_rig,
)

BODY_R_CAMERA = np.array([[0, 0, 1.0], [-1, 0, 0], [0, -1, 0]])
MIRRORED_RIGHT = np.diag([-1.0, 1, 1, 1])


def change_translation(change):
    def changed(camera_T_ego):
        camera_T_ego[:3, 3] = change(camera_T_ego[:3, 3])
        return camera_T_ego

    return changed


def move_ego_origin(right_m, down_m, forward_m):
    """Damage that moves the ego origin by these distances along the axes of FRONT."""
    return change_extrinsics("FRONT", change_translation(lambda t: t + np.array([right_m, down_m, forward_m])))


def wrong_quaternion_order(camera_T_ego):
    """A camera that looks 50 degrees to the left, with its x y z w quaternion read as w x y z."""
    rotation = rotation_z(np.radians(50)) @ BODY_R_CAMERA
    w = np.sqrt(1 + np.trace(rotation)) / 2
    x, y, z = (rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]) / (
        4 * w
    )
    a, b, c, d = x, y, z, w
    wrong = [
        [a * a + b * b - c * c - d * d, 2 * (b * c - a * d), 2 * (b * d + a * c)],
        [2 * (b * c + a * d), a * a - b * b + c * c - d * d, 2 * (c * d - a * b)],
        [2 * (b * d - a * c), 2 * (c * d + a * b), a * a - b * b - c * c + d * d],
    ]
    return inverse(rigid_transform(wrong, inverse(camera_T_ego)[:3, 3]))


def swap_width_and_height(scene):
    camera = scene["cameras"]["FRONT"]
    camera["width_px"], camera["height_px"] = camera["height_px"], camera["width_px"]


def halve_size(scene):
    scene["cameras"]["FRONT"].update(width_px=80, height_px=40)


def copy_calibration_of_left(scene):
    scene["cameras"]["FRONT"] = dict(scene["cameras"]["LEFT"])


def copy_extrinsics_of_left(scene):
    copy_calibration_of_left(scene)
    scene["cameras"]["FRONT"]["intrinsics_px"] = [[120, 0, 80], [0, 120, 40], [0, 0, 1]]


def copy_image_path_of_left(scene):
    for frame in scene["frames"]:
        frame["cameras"]["FRONT"]["image"] = "LEFT.png"


def name_a_missing_file(scene):
    scene["frames"][1]["cameras"]["FRONT"]["image"] = "none.png"


def lose_all_images(scene):
    for frame in scene["frames"]:
        frame["cameras"]["FRONT"]["image"] = None


def invert_extrinsics_in_one_frame(scene):
    scene["frames"][1]["cameras"]["FRONT"]["camera_T_ego"] = inverse(
        level_camera(0, mount_position(0)).camera_T_ego
    ).tolist()


# By description: the damage to FRONT, the expected verdict, and a part of the expected findings.
DAMAGES = {
    "inverted": (change_extrinsics("FRONT", inverse), "broken", "the matrix is ego_T_camera"),
    "inverted in one frame of three": (invert_extrinsics_in_one_frame, "broken", "the matrix is ego_T_camera"),
    "rotation transposed": (
        change_extrinsics("FRONT", lambda m: inverse(rigid_transform(m[:3, :3], inverse(m)[:3, 3]))),
        "suspect",
        "the rotation is transposed",
    ),
    "rotation transposed, translation kept": (
        change_extrinsics("FRONT", lambda m: rigid_transform(m[:3, :3].T, m[:3, 3])),
        "broken",
        "the rotation is transposed",
    ),
    "quaternion, translation kept": (
        change_extrinsics("FRONT", lambda m: rigid_transform(inverse(wrong_quaternion_order(m))[:3, :3].T, m[:3, 3])),
        "suspect",
        "the quaternion was read in the wrong order",
    ),
    "no translation": (
        change_extrinsics("FRONT", lambda m: rigid_transform(m[:3, :3], np.zeros(3))),
        "broken",
        "The translation is missing: all three values are 0.",
    ),
    "looking down": (
        change_extrinsics("FRONT", lambda m: pitch(-60) @ m),
        "suspect",
        "60.0 degrees down, rolled by 0.0",
    ),
    "looking to the side": (
        change_extrinsics("FRONT", lambda m: level_camera(100, mount_position(0)).camera_T_ego),
        "suspect",
        "straight ahead, as the name says; got 100.0 degrees",
    ),
    "position as translation": (
        change_extrinsics("FRONT", lambda m: rigid_transform(m[:3, :3], inverse(m)[:3, 3])),
        "broken",
        "the translation is the camera's position",
    ),
    "millimetres": (change_extrinsics("FRONT", change_translation(lambda t: 1000 * t)), "broken", "in millimetres"),
    "centimetres": (change_extrinsics("FRONT", change_translation(lambda t: 100 * t)), "broken", "in centimetres"),
    "in global coordinates": (move_ego_origin(1600, 0, -600), "broken", "20 m from"),
    "x forward": (
        change_extrinsics("FRONT", lambda m: rigid_transform(BODY_R_CAMERA, np.zeros(3)) @ m),
        "suspect",
        "the camera axes are x forward, y left, z up",
    ),
    "OpenGL": (change_extrinsics("FRONT", lambda m: np.diag([1.0, -1, -1, 1]) @ m), "suspect", "those of OpenGL"),
    "z down": (
        change_extrinsics("FRONT", lambda m: m @ np.diag([1.0, -1, -1, 1])),
        "broken",
        "y to the right and z down",
    ),
    "quaternion": (
        change_extrinsics("FRONT", wrong_quaternion_order),
        "suspect",
        "the quaternion was read in the wrong order",
    ),
    "looking up": (change_extrinsics("FRONT", lambda m: pitch(25) @ m), "suspect", "25.0 degrees up"),
    "upside down": (change_extrinsics("FRONT", lambda m: np.diag([-1.0, -1, 1, 1]) @ m), "suspect", "rolled by"),
    "below the road": (move_ego_origin(0, -2, 0), "broken", "below the road"),
    "on a mast": (move_ego_origin(0, 5, 0), "suspect", "z 6.50 m"),
    "mirrored": (change_extrinsics("FRONT", lambda m: MIRRORED_RIGHT @ m), "broken", "mirrored"),
    "scaled": (change_extrinsics("FRONT", lambda m: np.diag([3.0, 3, 3, 1]) @ m), "broken", "scaled by 3"),
    "not orthonormal": (
        change_extrinsics("FRONT", lambda m: m + np.eye(4, 4, 1) * 0.1),
        "broken",
        "The 3x3 part is not a rotation",
    ),
    "whole matrix transposed": (
        change_extrinsics("FRONT", np.transpose),
        "broken",
        "its translation is in the last row",
    ),
    "no matrix": (change_extrinsics("FRONT", np.zeros_like), "broken", "The last row"),
    "looking back": (
        change_extrinsics("FRONT", lambda m: level_camera(180, (1, 0, 1.5)).camera_T_ego),
        "suspect",
        "straight ahead, as the name says; got 180.0 degrees",
    ),
    "intrinsics transposed": (change_intrinsics("FRONT", np.transpose), "broken", "The matrix is transposed"),
    "negative focal length": (change_intrinsics("FRONT", lambda k: np.diag([-1, 1, 1]) @ k), "broken", "is negative"),
    "normalised": (change_intrinsics("FRONT", lambda k: np.diag([1 / 160, 1 / 80, 1]) @ k), "broken", "normalised"),
    "lens in millimetres": (
        change_intrinsics("FRONT", lambda k: np.diag([0.02, 0.02, 1]) @ k),
        "broken",
        "in millimetres",
    ),
    "half resolution": (change_intrinsics("FRONT", lambda k: np.diag([0.5, 0.5, 1]) @ k), "suspect", "about 80x40 px"),
    "double resolution": (change_intrinsics("FRONT", lambda k: np.diag([2, 2, 1]) @ k), "suspect", "about 320x160 px"),
    "stretched": (
        change_intrinsics("FRONT", lambda k: np.diag([1, 1.3, 1]) @ k),
        "suspect",
        "stretched in one direction",
    ),
    "skewed": (change_intrinsics("FRONT", lambda k: k + np.eye(3, 3, 1) * [[0, 9, 0]]), "suspect", "not skewed"),
    "fisheye": (
        change_intrinsics("FRONT", lambda k: k * [[0.4, 1, 1], [1, 0.4, 1], [1, 1, 1]]),
        "suspect",
        "a fisheye",
    ),
    "telephoto": (
        change_intrinsics("FRONT", lambda k: k * [[20, 1, 1], [1, 20, 1], [1, 1, 1]]),
        "suspect",
        "a telephoto lens",
    ),
    "width and height swapped": (swap_width_and_height, "broken", "Width and height are swapped"),
    "image of double size": (halve_size, "broken", "scaled by 2 after the calibration"),
    "pose of another": (copy_calibration_of_left, "broken", "the pose of LEFT"),
    "pose of another, other lens": (copy_extrinsics_of_left, "suspect", "the pose of LEFT"),
    "image of another": (copy_image_path_of_left, "broken", "the same file as LEFT"),
    "no file": (name_a_missing_file, "broken", "no such file"),
    "lost throughout": (lose_all_images, "suspect", "none in the 3 checked frames"),
}


@pytest.mark.parametrize("case", DAMAGES)
def test_damage_to_one_camera_is_found_with_its_cause(tmp_path, case):
    damage, verdict, text = DAMAGES[case]
    examination = examine_source(write_rig(tmp_path / "rig", damage))
    front = examination.views["FRONT"]
    findings = " ".join(map(str, front.findings))
    assert front.verdict == verdict, findings
    assert text in findings
    assert examination.views["BACK"].verdict is Verdict.OK
    assert examination.views["RIGHT"].verdict is Verdict.OK
    assert examination.motion_findings == ()
