"""Whole rigs: sound ones are ok, and what is broken is found, with the likely cause in words."""

import json
import re
import shutil
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from duospacenet.data.images import write_png
from duospacenet.jobs.sources import open_recording
from duospacenet.rig import RigRequirements, Verdict, examine
from duospacenet.rig.calibration import Calibration
from duospacenet.rig.camera_pairs import exchange_findings
from duospacenet.rig.rig_report import rig_report_dict
from duospacenet.runtime.bundle.manifest import PerceptionRange
from duospacenet.runtime.geometry import inverse, rigid, rotation_z
from examples.nuscenes_scene import is_here, write_scene_folder
from tests.helpers.rigs import AZIMUTHS_DEG, extrinsics, intrinsics, looking, mount, poses, times, write_rig

BODY_R_CAMERA = np.array([[0, 0, 1.0], [-1, 0, 0], [0, -1, 0]])
COARSE = PerceptionRange(size=(32, 32, 2), lower_m=(-51.2, -51.2, -3.0), upper_m=(51.2, 51.2, 5.0))
MIRRORED_RIGHT = np.diag([-1.0, 1, 1, 1])


def examined(folder, num_frames=8, **requirements):
    return examine(open_recording(str(folder)), RigRequirements(**{"perception": COARSE} | requirements), num_frames)


def translation(change):
    def changed(camera_T_ego):
        camera_T_ego[:3, 3] = change(camera_T_ego[:3, 3])
        return camera_T_ego

    return changed


def moved(right_m, down_m, forward_m):
    """The rig moved so far, seen from FRONT: the camera goes the other way."""
    return extrinsics("FRONT", translation(lambda t: t + np.array([right_m, down_m, forward_m])))


def quaternion_misread(camera_T_ego):
    """A camera that looks 50 degrees left, whose quaternion x y z w was read as w x y z."""
    turn = rotation_z(np.radians(50)) @ BODY_R_CAMERA
    w = np.sqrt(1 + np.trace(turn)) / 2
    x, y, z = (turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]) / (4 * w)
    a, b, c, d = x, y, z, w
    wrong = [
        [a * a + b * b - c * c - d * d, 2 * (b * c - a * d), 2 * (b * d + a * c)],
        [2 * (b * c + a * d), a * a - b * b + c * c - d * d, 2 * (c * d - a * b)],
        [2 * (b * d - a * c), 2 * (c * d + a * b), a * a - b * b - c * c + d * d],
    ]
    return inverse(rigid(wrong, inverse(camera_T_ego)[:3, 3]))


def pitched(up_deg):
    cos, sin = np.cos(np.radians(up_deg)), np.sin(np.radians(up_deg))
    return np.array([[1, 0, 0, 0], [0, cos, sin, 0], [0, -sin, cos, 0], [0, 0, 0, 1]])


def swapped_size(scene):
    camera = scene["cameras"]["FRONT"]
    camera["width_px"], camera["height_px"] = camera["height_px"], camera["width_px"]


def half_size(scene):
    scene["cameras"]["FRONT"].update(width_px=80, height_px=40)


def same_pose(scene):
    scene["cameras"]["FRONT"] = dict(scene["cameras"]["LEFT"])


def same_pose_other_lens(scene):
    same_pose(scene)
    scene["cameras"]["FRONT"]["intrinsics_px"] = [[120, 0, 80], [0, 120, 40], [0, 0, 1]]


def same_path(scene):
    for frame in scene["frames"]:
        frame["cameras"]["FRONT"]["image"] = "LEFT.png"


def no_file(scene):
    scene["frames"][1]["cameras"]["FRONT"]["image"] = "none.png"


def no_picture(scene):
    for frame in scene["frames"]:
        frame["cameras"]["FRONT"]["image"] = None


def in_one_frame_only(scene):
    scene["frames"][1]["cameras"]["FRONT"]["camera_T_ego"] = inverse(looking(0, mount(0)).camera_T_ego).tolist()


# By what is done to FRONT: the damage, its verdict, and words of its findings.
CAMERAS = {
    "inverted": (extrinsics("FRONT", inverse), "broken", "the matrix is ego_T_camera"),
    "inverted in one frame of three": (in_one_frame_only, "broken", "the matrix is ego_T_camera"),
    "rotation transposed": (
        extrinsics("FRONT", lambda m: inverse(rigid(m[:3, :3], inverse(m)[:3, 3]))),
        "suspect",
        "the rotation is transposed",
    ),
    "rotation transposed, translation kept": (
        extrinsics("FRONT", lambda m: rigid(m[:3, :3].T, m[:3, 3])),
        "broken",
        "the rotation is transposed",
    ),
    "quaternion, translation kept": (
        extrinsics("FRONT", lambda m: rigid(inverse(quaternion_misread(m))[:3, :3].T, m[:3, 3])),
        "suspect",
        "a quaternion was read in the wrong order",
    ),
    "no translation": (
        extrinsics("FRONT", lambda m: rigid(m[:3, :3], np.zeros(3))),
        "broken",
        "The translation is missing: all of it is 0.",
    ),
    "looking down": (extrinsics("FRONT", lambda m: pitched(-60) @ m), "suspect", "60.0 degrees down, rolled by 0.0"),
    "looking to the side": (
        extrinsics("FRONT", lambda m: looking(100, mount(0)).camera_T_ego),
        "suspect",
        "straight ahead, as the name says; got 100.0 degrees",
    ),
    "position as translation": (
        extrinsics("FRONT", lambda m: rigid(m[:3, :3], inverse(m)[:3, 3])),
        "broken",
        "the translation is the camera's position",
    ),
    "millimetres": (extrinsics("FRONT", translation(lambda t: 1000 * t)), "broken", "in millimetres"),
    "centimetres": (extrinsics("FRONT", translation(lambda t: 100 * t)), "broken", "in centimetres"),
    "in global coordinates": (moved(1600, 0, -600), "broken", "20 m from"),
    "x forward": (
        extrinsics("FRONT", lambda m: rigid(BODY_R_CAMERA, np.zeros(3)) @ m),
        "suspect",
        "the camera axes are x forward, y left, z up",
    ),
    "OpenGL": (extrinsics("FRONT", lambda m: np.diag([1.0, -1, -1, 1]) @ m), "suspect", "those of OpenGL"),
    "z down": (extrinsics("FRONT", lambda m: m @ np.diag([1.0, -1, -1, 1])), "broken", "y to the right and z down"),
    "quaternion": (extrinsics("FRONT", quaternion_misread), "suspect", "a quaternion was read in the wrong order"),
    "looking up": (extrinsics("FRONT", lambda m: pitched(25) @ m), "suspect", "25.0 degrees up"),
    "upside down": (extrinsics("FRONT", lambda m: np.diag([-1.0, -1, 1, 1]) @ m), "suspect", "rolled by"),
    "below the road": (moved(0, -2, 0), "broken", "below the road"),
    "on a mast": (moved(0, 5, 0), "suspect", "z 6.50 m"),
    "mirrored": (extrinsics("FRONT", lambda m: MIRRORED_RIGHT @ m), "broken", "mirrored"),
    "scaled": (extrinsics("FRONT", lambda m: np.diag([3.0, 3, 3, 1]) @ m), "broken", "scaled by 3"),
    "not orthonormal": (extrinsics("FRONT", lambda m: m + np.eye(4, 4, 1) * 0.1), "broken", "No rotation is like this"),
    "whole matrix transposed": (extrinsics("FRONT", np.transpose), "broken", "its translation stands in the last row"),
    "no matrix": (extrinsics("FRONT", np.zeros_like), "broken", "The last row"),
    "looking back": (
        extrinsics("FRONT", lambda m: looking(180, (1, 0, 1.5)).camera_T_ego),
        "suspect",
        "straight ahead, as the name says; got 180.0 degrees",
    ),
    "intrinsics transposed": (intrinsics("FRONT", np.transpose), "broken", "The matrix is transposed"),
    "negative focal length": (intrinsics("FRONT", lambda k: np.diag([-1, 1, 1]) @ k), "broken", "is negative"),
    "normalised": (intrinsics("FRONT", lambda k: np.diag([1 / 160, 1 / 80, 1]) @ k), "broken", "normalised"),
    "lens in millimetres": (intrinsics("FRONT", lambda k: np.diag([0.02, 0.02, 1]) @ k), "broken", "in millimetres"),
    "half resolution": (intrinsics("FRONT", lambda k: np.diag([0.5, 0.5, 1]) @ k), "suspect", "about 80x40 px"),
    "double resolution": (intrinsics("FRONT", lambda k: np.diag([2, 2, 1]) @ k), "suspect", "about 320x160 px"),
    "squeezed": (intrinsics("FRONT", lambda k: np.diag([1, 1.3, 1]) @ k), "suspect", "squeezed in one direction"),
    "skewed": (intrinsics("FRONT", lambda k: k + np.eye(3, 3, 1) * [[0, 9, 0]]), "suspect", "not slanted"),
    "fisheye": (intrinsics("FRONT", lambda k: k * [[0.4, 1, 1], [1, 0.4, 1], [1, 1, 1]]), "suspect", "a fisheye"),
    "telescope": (intrinsics("FRONT", lambda k: k * [[20, 1, 1], [1, 20, 1], [1, 1, 1]]), "suspect", "a telescope"),
    "width and height swapped": (swapped_size, "broken", "Width and height are swapped"),
    "picture of double size": (half_size, "broken", "scaled by 2 after the calibration"),
    "pose of another": (same_pose, "broken", "that of LEFT"),
    "pose of another, other lens": (same_pose_other_lens, "suspect", "that of LEFT"),
    "picture of another": (same_path, "broken", "the file of LEFT"),
    "no file": (no_file, "broken", "no such file"),
    "lost throughout": (no_picture, "suspect", "none in the 3 frames"),
}


@pytest.mark.parametrize("case", CAMERAS)
def test_a_broken_camera_is_found_with_its_cause(tmp_path, case):
    damage, verdict, words = CAMERAS[case]
    examination = examined(write_rig(tmp_path / "rig", damage))
    front = examination.views["FRONT"]
    told = " ".join(map(str, front.findings))
    assert front.verdict == verdict, told
    assert words in told
    assert examination.views["BACK"].verdict is Verdict.OK
    assert examination.views["RIGHT"].verdict is Verdict.OK
    assert examination.motion_findings == ()


def shifted_at(index):
    def damage(scene):
        for frame in scene["frames"][index:]:
            frame["global_T_ego"][1][3] += 500

    return damage


def older(scene):
    scene["frames"][2]["timestamp_s"] = scene["frames"][0]["timestamp_s"]


def scaled(pose):
    pose[:3, 3] *= 1000
    return pose


def headed(yaw_deg):
    return lambda pose: pose @ rigid(rotation_z(np.radians(yaw_deg)), np.zeros(3))


def longer(damage):
    """Damage to a drive of five frames."""

    def longer_damage(scene):
        first = scene["frames"][0]
        for index in (3, 4):
            pose = np.array(first["global_T_ego"], dtype=float)
            pose[0, 3] += 4 * index
            scene["frames"].append(first | {"timestamp_s": 100 + index / 2, "global_T_ego": pose.tolist()})
        damage(scene)

    return longer_damage


def turned_around(frame):
    frame["global_T_ego"] = headed(180)(np.array(frame["global_T_ego"], dtype=float)).tolist()


def flipping(scene):
    turned_around(scene["frames"][1])


def flipped_at_the_end(scene):
    longer(lambda _: None)(scene)
    turned_around(scene["frames"][4])


DRIVES = {
    "Unix time in ms": (times(lambda t: 1.5e12 + 1000 * t), "broken", "It is in milliseconds."),
    "Unix time in us": (times(lambda t: 1.5e15 + 1e6 * t), "broken", "It is in microseconds."),
    "Unix time in ns": (times(lambda t: 1.5e18 + 1e9 * t), "broken", "It is in nanoseconds."),
    "time in ms": (times(lambda t: 1000 * t), "suspect", "The times are in milliseconds."),
    "time in us": (times(lambda t: 1e6 * t), "suspect", "The times are in microseconds."),
    "an older frame": (older, "broken", "-0.5 s from frame 1 to frame 2"),
    "positions in mm": (poses(scaled), "broken", "not in metres"),
    "one jump": (shifted_at(2), "suspect", "The scene is cut there"),
    "sideways": (longer(poses(headed(90))), "broken", "The ego frame has y ahead, not x"),
    "sideways, twice only": (poses(headed(90)), "suspect", "90 degrees off it"),
    "headings that flip": (flipping, "broken", "at most 180 degrees a second; got 180 degrees in 0.5 s, from frame 0"),
    "one flip": (flipped_at_the_end, "suspect", "The scene is cut there, or the heading jumped"),
    "time in kiloseconds": (times(lambda t: t / 1000), "broken", "in a larger unit than seconds"),
    "a bit sideways": (poses(headed(30)), "suspect", "30 degrees off it"),
    "rotation that is none": (poses(lambda p: p @ np.diag([2.0, 1, 1, 1])), "broken", "orthonormal"),
}


@pytest.mark.parametrize("case", DRIVES)
def test_broken_times_and_poses_are_found_with_their_cause(tmp_path, case):
    damage, verdict, words = DRIVES[case]
    examination = examined(write_rig(tmp_path / "rig", damage))
    told = " ".join(map(str, examination.motion_findings))
    assert examination.motion_verdict == verdict, told
    assert words in told
    assert {view.verdict for view in examination.views.values()} == {Verdict.OK}


def test_inverted_poses_of_a_drive_that_turns_are_told_from_a_wrong_heading(tmp_path):
    """Frames on a circle, 4 m apart, headed along it; far from the origin, so that the inverse moves wildly."""

    def damage(scene):
        for index, frame in enumerate(scene["frames"]):
            yaw = 0.5 + 0.1 * index
            pose = rigid(rotation_z(yaw), [600 + 40 * np.sin(yaw), 1600 - 40 * np.cos(yaw), 0])
            frame["global_T_ego"] = pose.tolist()

    assert examined(write_rig(tmp_path / "right", damage)).verdict is Verdict.OK

    def inverted(scene):
        damage(scene)
        poses(inverse)(scene)

    examination = examined(write_rig(tmp_path / "inverted", inverted))
    assert examination.motion_verdict is Verdict.BROKEN
    assert "global_T_ego is inverted" in " ".join(map(str, examination.motion_findings))


@pytest.mark.parametrize("down_deg", [50, 60, 75, 90])
@pytest.mark.parametrize("azimuth_deg", [0, 90, 180, -90])
def test_an_upright_camera_that_looks_down_may_be_for_parking(azimuth_deg, down_deg):
    camera = looking(azimuth_deg, mount(azimuth_deg))
    down = replace(camera, camera_T_ego=pitched(-down_deg) @ camera.camera_T_ego)
    (finding,) = Calibration.of("a", down).findings
    assert finding.verdict is Verdict.SUSPECT
    assert finding.cause.startswith("A camera for parking may be mounted so")
    assert "quaternion" not in finding.cause
    assert f"looking {down_deg}.0 degrees down" in finding.got
    assert "nan" not in finding.got
    assert "-0.0 degrees" not in finding.got
    assert ("rolled" in finding.got) == (down_deg < 90)


def test_a_frame_without_cameras_says_so(tmp_path):
    folder = write_rig(tmp_path / "rig", lambda scene: scene["cameras"].clear() or no_cameras(scene["frames"]))
    examination = examined(folder)
    (finding,) = examination.motion_findings
    assert str(finding).startswith("cameras: expected at least one; got none. Neither the frame nor the scene has any.")
    assert (finding.verdict, finding.num_frames) == ("broken", 3)


def no_cameras(frames):
    for frame in frames:
        frame["cameras"] = {}


def test_a_camera_that_sees_none_of_the_range_is_doubted(tmp_path):
    ahead = PerceptionRange(size=(32, 32, 2), lower_m=(5.0, -51.2, -3.0), upper_m=(51.2, 51.2, 5.0))
    views = examined(write_rig(tmp_path / "rig"), perception=ahead).views
    assert {name: [finding.subject for finding in view.findings] for name, view in views.items()} == {
        "FRONT": [],
        "LEFT": [],
        "BACK": ["coverage"],
        "RIGHT": [],
    }
    assert views["BACK"].verdict is Verdict.SUSPECT
    assert "none that BACK sees" in str(views["BACK"].findings[0])


@pytest.mark.parametrize("up_deg", [-40, -10, 10])
def test_a_camera_may_look_a_little_up_and_far_down(tmp_path, up_deg):
    damage = extrinsics("FRONT", lambda m: pitched(up_deg) @ m)
    assert examined(write_rig(tmp_path / "rig", damage)).verdict is Verdict.OK


def test_cameras_at_one_place_that_look_apart_are_fine(tmp_path):
    """As those are that are cut out of one wide picture."""
    at_left = looking(0, mount(90)).camera_T_ego
    examination = examined(write_rig(tmp_path / "rig", extrinsics("FRONT", lambda m: at_left)))
    assert examination.verdict is Verdict.OK


def test_another_scene_may_start_earlier_and_elsewhere(tmp_path):
    def two_scenes(scene):
        scene["frames"][2].update(scene="street", timestamp_s=0.0)
        scene["frames"][2]["global_T_ego"][0][3] = -9000

    assert examined(write_rig(tmp_path / "rig", two_scenes)).verdict is Verdict.OK


@pytest.mark.parametrize(
    ("size_px", "words"),
    [
        ((80, 160), "Width and height are swapped"),
        ((320, 160), "scaled by 2 after the calibration"),
        ((160, 60), "The picture was cut after the calibration"),
    ],
)
def test_a_picture_of_another_size_than_calibrated_is_told_apart_by_its_header(tmp_path, size_px, words):
    folder = write_rig(tmp_path / "rig")
    write_png(folder / "FRONT.png", np.full((size_px[1], size_px[0], 3), 9, np.uint8))
    (finding,) = examined(folder).views["FRONT"].findings
    assert (finding.subject, finding.verdict, finding.num_frames) == ("picture", "broken", 3)
    assert finding.expected == "160x80 px, as the calibration says"
    assert finding.got == f"{size_px[0]}x{size_px[1]} px"
    assert words in finding.cause


def test_driving_backward_and_standing_still_are_fine(tmp_path):
    assert examined(write_rig(tmp_path / "backward", poses(headed(180)))).verdict is Verdict.OK
    still = write_rig(
        tmp_path / "still", lambda scene: [f.update(global_T_ego=np.eye(4).tolist()) for f in scene["frames"]]
    )
    assert examined(still).verdict is Verdict.OK


def test_headings_that_flip_are_not_told_as_sideways_motion_too(tmp_path):
    def flipping(scene):
        longer(lambda _: None)(scene)
        for frame in scene["frames"][1::2]:
            frame["global_T_ego"] = headed(100)(np.array(frame["global_T_ego"], dtype=float)).tolist()

    (finding,) = examined(write_rig(tmp_path / "rig", flipping)).motion_findings
    assert finding.subject == "turn"


@pytest.mark.parametrize(("jump_m", "subjects"), [(1.0, []), (500.0, ["speed"])])
def test_one_jump_to_the_side_of_a_parked_vehicle_says_nothing_about_its_heading(tmp_path, jump_m, subjects):
    def parked(scene):
        longer(poses(lambda pose: np.eye(4)))(scene)
        for frame in scene["frames"][3:]:
            frame["global_T_ego"][1][3] = jump_m

    examination = examined(write_rig(tmp_path / "rig", parked))
    assert [finding.subject for finding in examination.motion_findings] == subjects
    assert examination.motion_verdict is (Verdict.SUSPECT if subjects else Verdict.OK)


def test_a_bundle_says_how_fast_a_vehicle_turns(tmp_path):
    """A quarter turn in half a second is what the usual limit just allows."""

    def turning(scene):
        scene["frames"][2]["global_T_ego"] = headed(80)(np.array(scene["frames"][2]["global_T_ego"])).tolist()

    folder = write_rig(tmp_path / "rig", turning)
    assert "turn" not in [finding.subject for finding in examined(folder).motion_findings]
    slow = examined(folder, largest_turn_rad_s=1.0)
    assert "at most 57.2958 degrees a second; got 80 degrees" in " ".join(map(str, slow.motion_findings))


def test_more_cameras_than_the_bundle_takes_are_refused_and_as_many_are_not(tmp_path):
    folder = write_rig(tmp_path / "rig")
    assert examined(folder, num_cameras=4).verdict is Verdict.OK
    examination = examined(folder, num_cameras=3)
    assert examination.motion_verdict is Verdict.BROKEN
    assert "expected 1 to 3, as the bundle was exported; got 4" in str(examination.motion_findings[0])
    assert examination.motion_findings[0].num_frames == 3


@pytest.mark.parametrize("seed", range(6))
def test_drawn_rigs_are_ok(seed):
    examination = examined(f"synthetic:{seed}:4", num_frames=1)
    assert examination.verdict is Verdict.OK
    assert all(view.photo.image is not None for view in examination.views.values())
    assert examination.coverage.shares_by_count()["0"] < 0.05


@pytest.mark.skipif(not is_here(), reason="the nuScenes frames do not lie beside this checkout")
def test_the_real_rig_is_ok_though_its_calibration_changes_from_frame_to_frame(tmp_path):
    examination = examined(write_scene_folder(tmp_path / "scene"))
    assert examination.verdict is Verdict.OK
    assert {view.num_calibrations for view in examination.views.values()} == {4}
    assert examination.blind_sectors == ()
    # nuScenes' cameras: 70 degrees across (110 behind) by its paper; 1600 px of 1266 and 809 px are 65 and 90.
    angles = rig_report_dict("", examination, dict.fromkeys(examination.views, ""))["cameras"]
    assert angles["CAM_FRONT"]["field_of_view_deg"]["horizontal"] == pytest.approx(64.6, abs=1)
    assert angles["CAM_BACK"]["field_of_view_deg"]["horizontal"] == pytest.approx(89.4, abs=1)
    assert angles["CAM_FRONT_LEFT"]["azimuth_deg"] == pytest.approx(55, abs=3)


RESIZES = [0.6, 2 / 3, 0.75, 0.8, 1.25]


@pytest.mark.parametrize("factor", RESIZES)
def test_intrinsics_of_another_resolution_are_doubted_whatever_the_factor(factor):
    """nuScenes' front camera: its principal point is 2 % and 9 % of the half off the middle."""
    lens = np.array([[1266.417, 0, 816.267], [0, 1266.417, 491.507], [0, 0, 1]])
    camera = looking(0, width_px=1600, height_px=900, intrinsics_px=lens)
    assert Calibration.of("FRONT", camera).findings == ()
    resized = replace(camera, intrinsics_px=np.diag([factor, factor, 1]) @ lens)
    (finding,) = Calibration.of("FRONT", resized).findings
    assert finding.verdict is Verdict.SUSPECT
    words = re.search(r"of another resolution, about (\d+)x(\d+) px, ([0-9.]+) times the 1600x900 px", finding.cause)
    assert [float(word) for word in words.groups()] == pytest.approx(
        [1600 * factor, 900 * factor, factor], rel=0.08, abs=0.005
    )


def test_principal_points_of_drawn_rigs_are_no_doubt():
    for seed in range(40):
        for name, camera in open_recording(f"synthetic:{seed}:1").frame_without_images(0).cameras.items():
            assert Calibration.of(name, camera).findings == ()


@pytest.mark.skipif(not is_here(), reason="the nuScenes frames do not lie beside this checkout")
@pytest.mark.parametrize("factor", RESIZES)
def test_every_camera_of_the_real_rig_is_doubted_with_intrinsics_of_another_resolution(tmp_path, factor):
    for name, camera in (
        open_recording(str(write_scene_folder(tmp_path / "scene"))).frame_without_images(0).cameras.items()
    ):
        resized = replace(camera, intrinsics_px=np.diag([factor, factor, 1]) @ camera.intrinsics_px)
        assert "of another resolution" in " ".join(map(str, Calibration.of(name, resized).findings))


NUSCENES_DEG = {"FRONT": 0, "FRONT_LEFT": 55, "FRONT_RIGHT": -57, "BACK": 180, "BACK_LEFT": 108, "BACK_RIGHT": -112}


@pytest.mark.parametrize(
    ("one", "other"), [("FRONT", "FRONT_LEFT"), ("FRONT_RIGHT", "BACK_RIGHT"), ("BACK_LEFT", "BACK")]
)
def test_cameras_of_neighbouring_names_that_were_exchanged_are_doubted(one, other):
    azimuths = NUSCENES_DEG | {one: NUSCENES_DEG[other], other: NUSCENES_DEG[one]}
    told = {name: exchanges(azimuths, name) for name in azimuths}
    assert told[one] == [f"direction beside {other}"]
    assert told[other] == [f"direction beside {one}"]
    assert not any(told[name] for name in azimuths if name not in (one, other))


@pytest.mark.parametrize(
    "azimuths",
    [
        NUSCENES_DEG,
        {"LEFT": 0, "RIGHT": 0},  # a stereo pair
        {"LEFT_MIRROR": 150, "RIGHT_MIRROR": -150, "BACK_LEFT": 110, "BACK_RIGHT": -110},
        {"FRONT": 15, "FRONT_LEFT": 5},  # 55 degrees off in all, and exchanged 45
        {"a": 90, "b": 0},
    ],
)
def test_cameras_that_were_not_exchanged_are_left_in_peace(azimuths):
    assert not any(exchanges(azimuths, name) for name in azimuths)


def exchanges(azimuths, name):
    """The subjects of what is found between a camera and each other one of a rig."""
    rig = {each: Calibration.of(each, looking(azimuth, mount(azimuth))) for each, azimuth in azimuths.items()}
    pairs = [found for pair in combinations(rig.values(), 2) for found in exchange_findings(*pair)]
    return [finding.subject for whose, finding in pairs if whose == name]


def test_exchanged_cameras_make_a_rig_suspect(tmp_path):
    def exchanged(scene):
        turned = looking(50, mount(50)).camera_T_ego.tolist(), looking(0, mount(0)).camera_T_ego.tolist()
        scene["cameras"]["FRONT"]["camera_T_ego"], scene["cameras"]["LEFT"]["camera_T_ego"] = turned

    views = examined(write_rig(tmp_path / "rig", exchanged)).views
    assert [views[name].verdict for name in AZIMUTHS_DEG] == ["suspect", "suspect", "ok", "ok"]
    assert "50.0 degrees to the left, nearer to the name of LEFT" in " ".join(map(str, views["FRONT"].findings))


def test_twins_are_found_in_each_frame_though_one_is_lost_in_the_first_and_both_move(tmp_path):
    """As in nuScenes, where calibrations are those of each picture's own time."""

    def twins(scene):
        for index, frame in enumerate(scene["frames"]):
            moved = looking(90, (1 + 0.1 * index, 0.5, 1.5)).camera_T_ego.tolist()
            for name in ("FRONT_LEFT", "LEFT"):
                frame["cameras"][name] = {"image": f"{name}.png", "camera_T_ego": moved}
            del frame["cameras"]["FRONT"]
        scene["cameras"]["FRONT_LEFT"] = scene["cameras"].pop("FRONT")
        scene["frames"][0]["cameras"]["LEFT"]["image"] = None

    folder = write_rig(tmp_path / "rig", twins)
    (folder / "FRONT.png").rename(folder / "FRONT_LEFT.png")
    views = examined(folder).views
    for name, twin in (("LEFT", "FRONT_LEFT"), ("FRONT_LEFT", "LEFT")):
        (finding,) = views[name].findings
        assert (finding.subject, finding.verdict, finding.num_frames) == (f"pose beside {twin}", "broken", 3)


def test_broken_cameras_are_left_out_of_what_the_rig_sees(tmp_path):
    whole = examined(write_rig(tmp_path / "whole"))
    damaged = examined(write_rig(tmp_path / "damaged", extrinsics("LEFT", inverse)))
    assert list(damaged.coverage.voxels) == ["FRONT", "BACK", "RIGHT"]
    assert damaged.coverage.share("FRONT") == whole.coverage.share("FRONT")
    assert whole.blind_sectors == ()
    # FRONT's border starts 1.5 m ahead of the origin, and is crossed 1.5 / (cos - sin) m away: at 42.5 degrees after
    # 24.3 of 69.4 m, at 43.5 after 40.5 of 70.6. BACK's is left after 0.5 / (sin + cos): at 133.5 degrees after 13.5
    # of 70.6 m, at 134.5 after 40.4 of 71.8.
    assert damaged.blind_sectors == ((43, 134),)


def test_a_fault_of_one_frame_is_shown_in_that_frame_and_counted_once(tmp_path):
    view = examined(write_rig(tmp_path / "rig", in_one_frame_only), num_frames=1).views["FRONT"]
    assert view.frame == 1
    assert [(finding.frame, finding.num_frames) for finding in view.findings] == [(1, 1)]
    assert view.num_calibrations == 2
    always = examined(write_rig(tmp_path / "always", extrinsics("FRONT", inverse))).views["FRONT"]
    assert [(finding.frame, finding.num_frames) for finding in always.findings] == [(0, 3)]


def test_a_lost_camera_is_shown_in_a_frame_that_has_its_picture(tmp_path):
    def lost_at_first(scene):
        scene["frames"][0]["cameras"]["FRONT"]["image"] = None

    view = examined(write_rig(tmp_path / "rig", lost_at_first)).views["FRONT"]
    assert (view.frame, view.verdict, view.photo.size_px) == (1, Verdict.OK, (160, 80))


def test_pictures_with_the_same_pixels_in_other_files_are_found(tmp_path):
    folder = write_rig(tmp_path / "rig")
    shutil.copy(folder / "LEFT.png", folder / "FRONT.png")
    examination = examined(folder)
    assert "the pixels of LEFT" in str(examination.views["FRONT"].findings[0])
    assert examination.views["LEFT"].verdict is Verdict.BROKEN
    write_png(folder / "FRONT.png", np.zeros((80, 160, 3), np.uint8))
    write_png(folder / "LEFT.png", np.zeros((80, 160, 3), np.uint8))
    assert examined(folder).verdict is Verdict.OK  # at night, all pictures are alike


def test_only_as_many_frames_are_looked_at_as_are_asked_for(tmp_path):
    folder = write_rig(tmp_path / "rig")
    assert list(examined(folder, num_frames=1).sizes) == [0]
    assert list(examined(folder, num_frames=2).sizes) == [0, 2]
    assert examined(folder).sizes[1]["LEFT"] == ((160, 80), (160, 80))


def test_the_report_is_strict_json_whatever_the_numbers_are(tmp_path):
    def wild(scene):
        extrinsics("FRONT", lambda m: m * 1e300)(scene)
        intrinsics("LEFT", lambda k: k * 1e-300)(scene)
        intrinsics("RIGHT", np.zeros_like)(scene)
        extrinsics("BACK", np.zeros_like)(scene)

    examination = examined(write_rig(tmp_path / "rig", wild))
    report = json.loads(json.dumps(rig_report_dict("rig", examination, dict.fromkeys(examination.views, "")), allow_nan=False))
    assert {camera["verdict"] for camera in report["cameras"].values()} == {"broken"}
    assert report["cameras"]["BACK"]["position_m"] == [None] * 3
    assert report["rig"]["voxels_seen_by"] is None
    assert report["rig"]["blind_sectors_deg"] == [[0, 360]]
