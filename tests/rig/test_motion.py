"""Wrong times and ego poses are found, with the right verdict and cause."""

import numpy as np
import pytest

from duospacenet.rig import Verdict
from duospacenet.runtime.geometry import inverse, rigid_transform, rotation_z
from tests.helpers.rigs import change_poses, change_times, examine_source, write_rig


def jump_at(index):
    """Damage that shifts all positions by 500 m from one frame on."""

    def damage(scene):
        for frame in scene["frames"][index:]:
            frame["global_T_ego"][1][3] += 500

    return damage


def repeat_first_time(scene):
    scene["frames"][2]["timestamp_s"] = scene["frames"][0]["timestamp_s"]


def to_millimetres(pose):
    pose[:3, 3] *= 1000
    return pose


def turn_heading(yaw_deg):
    return lambda pose: pose @ rigid_transform(rotation_z(np.radians(yaw_deg)), np.zeros(3))


def with_five_frames(damage):
    """Extend a scene from three to five frames, then damage it."""

    def extend_and_damage(scene):
        first = scene["frames"][0]
        for index in (3, 4):
            pose = np.array(first["global_T_ego"], dtype=float)
            pose[0, 3] += 4 * index
            images = scene["frames"][index - 2]["cameras"]
            scene["frames"].append({"timestamp_s": 100 + index / 2, "global_T_ego": pose.tolist(), "cameras": images})
        damage(scene)

    return extend_and_damage


def reverse_heading(frame):
    frame["global_T_ego"] = turn_heading(180)(np.array(frame["global_T_ego"], dtype=float)).tolist()


def reverse_second_heading(scene):
    reverse_heading(scene["frames"][1])


def reverse_last_heading_of_five(scene):
    with_five_frames(lambda _: None)(scene)
    reverse_heading(scene["frames"][4])


# By description: the damage, the expected verdict, and a part of the expected findings.
DAMAGES = {
    "Unix time in ms": (change_times(lambda t: 1.5e12 + 1000 * t), "broken", "The time is in milliseconds."),
    "Unix time in us": (change_times(lambda t: 1.5e15 + 1e6 * t), "broken", "The time is in microseconds."),
    "Unix time in ns": (change_times(lambda t: 1.5e18 + 1e9 * t), "broken", "The time is in nanoseconds."),
    "time in ms": (change_times(lambda t: 1000 * t), "suspect", "Likely cause: the times are in milliseconds."),
    "time in us": (change_times(lambda t: 1e6 * t), "suspect", "Likely cause: the times are in microseconds."),
    "an older frame": (repeat_first_time, "broken", "-0.5 s from frame 1 to frame 2"),
    "positions in mm": (change_poses(to_millimetres), "broken", "the positions are in millimetres"),
    "one jump": (jump_at(2), "suspect", "Likely cause: a scene cut"),
    "sideways": (
        with_five_frames(change_poses(turn_heading(90))),
        "broken",
        "the ego frame has y forward instead of x",
    ),
    "sideways, twice only": (change_poses(turn_heading(90)), "suspect", "a median angle of 90 degrees"),
    "headings that flip": (
        reverse_second_heading,
        "broken",
        "at most 180 degrees per second; got 180 degrees in 0.5 s, from frame 0",
    ),
    "one flip": (reverse_last_heading_of_five, "suspect", "a scene cut, or a jump of the heading"),
    "time in kiloseconds": (change_times(lambda t: t / 1000), "broken", "in a larger unit than seconds"),
    "a bit sideways": (change_poses(turn_heading(30)), "suspect", "a median angle of 30 degrees"),
    "scaled rotation": (change_poses(lambda p: p @ np.diag([2.0, 1, 1, 1])), "broken", "orthonormal"),
}


@pytest.mark.parametrize("case", DAMAGES)
def test_wrong_times_and_poses_are_found_with_their_cause(tmp_path, case):
    damage, verdict, text = DAMAGES[case]
    examination = examine_source(write_rig(tmp_path / "rig", damage))
    findings = " ".join(map(str, examination.motion_findings))
    assert examination.motion_verdict == verdict, findings
    assert text in findings
    assert {view.verdict for view in examination.views.values()} == {Verdict.OK}


def test_inverted_poses_on_a_curve_are_distinguished_from_a_wrong_heading(tmp_path):
    """The frames are on a circle far from the origin, 4 m apart. There, inverted poses move by large distances."""

    def drive_on_circle(scene):
        for index, frame in enumerate(scene["frames"]):
            yaw = 0.5 + 0.1 * index
            pose = rigid_transform(rotation_z(yaw), [600 + 40 * np.sin(yaw), 1600 - 40 * np.cos(yaw), 0])
            frame["global_T_ego"] = pose.tolist()

    assert examine_source(write_rig(tmp_path / "right", drive_on_circle)).verdict is Verdict.OK

    def invert_poses(scene):
        drive_on_circle(scene)
        change_poses(inverse)(scene)

    examination = examine_source(write_rig(tmp_path / "inverted", invert_poses))
    assert examination.motion_verdict is Verdict.BROKEN
    assert "global_T_ego is inverted" in " ".join(map(str, examination.motion_findings))


def test_a_frame_without_cameras_is_broken(tmp_path):
    folder = write_rig(tmp_path / "rig", lambda scene: scene["cameras"].clear() or remove_cameras(scene["frames"]))
    examination = examine_source(folder)
    (finding,) = examination.motion_findings
    assert str(finding).startswith(
        "cameras: expected at least one camera; got no camera. Neither the frame nor the scene defines a camera."
    )
    assert (finding.verdict, finding.num_frames) == ("broken", 3)


def remove_cameras(frames):
    for frame in frames:
        frame["cameras"] = {}


def test_another_scene_may_start_at_an_earlier_time_and_at_another_place(tmp_path):
    def two_scenes(scene):
        scene["frames"][2].update(scene="street", timestamp_s=0.0)
        scene["frames"][2]["global_T_ego"][0][3] = -9000

    assert examine_source(write_rig(tmp_path / "rig", two_scenes)).verdict is Verdict.OK


def test_driving_backward_and_standing_still_are_ok(tmp_path):
    assert examine_source(write_rig(tmp_path / "backward", change_poses(turn_heading(180)))).verdict is Verdict.OK
    parked = examine_source(write_rig(tmp_path / "parked", park))
    assert parked.verdict is Verdict.OK
    assert parked.motion_verdict is Verdict.NOT_JUDGED
    assert "too short a drive" in str(parked.not_judged[0])


def test_alternating_headings_are_not_also_reported_as_sideways_motion(tmp_path):
    def alternate_headings(scene):
        with_five_frames(lambda _: None)(scene)
        for frame in scene["frames"][1::2]:
            frame["global_T_ego"] = turn_heading(100)(np.array(frame["global_T_ego"], dtype=float)).tolist()

    (finding,) = examine_source(write_rig(tmp_path / "rig", alternate_headings)).motion_findings
    assert finding.subject == "turn rate"


def park(scene):
    """Give all frames the same pose and the same images."""
    for frame in scene["frames"]:
        frame.update(global_T_ego=np.eye(4).tolist(), cameras=scene["frames"][0]["cameras"])


@pytest.mark.parametrize(("jump_m", "subjects"), [(0.9, []), (500.0, ["speed"])])
def test_one_sideways_jump_of_a_parked_vehicle_is_not_reported_as_a_wrong_heading(tmp_path, jump_m, subjects):
    def parked(scene):
        with_five_frames(park)(scene)
        for frame in scene["frames"][3:]:
            frame["global_T_ego"][1][3] = jump_m

    examination = examine_source(write_rig(tmp_path / "rig", parked))
    assert [finding.subject for finding in examination.motion_findings] == subjects
    assert examination.motion_verdict is (Verdict.SUSPECT if subjects else Verdict.NOT_JUDGED)


def test_the_largest_turn_rate_comes_from_the_bundle(tmp_path):
    """The default limit allows a quarter turn in half a second."""

    def turning(scene):
        scene["frames"][2]["global_T_ego"] = turn_heading(80)(np.array(scene["frames"][2]["global_T_ego"])).tolist()

    folder = write_rig(tmp_path / "rig", turning)
    assert "turn rate" not in [finding.subject for finding in examine_source(folder).motion_findings]
    slow = examine_source(folder, largest_turn_rad_s=1.0)
    assert "at most 57.2958 degrees per second; got 80 degrees" in " ".join(map(str, slow.motion_findings))


def test_more_cameras_than_the_bundle_accepts_are_broken_and_as_many_are_ok(tmp_path):
    folder = write_rig(tmp_path / "rig")
    assert examine_source(folder, num_cameras=4).verdict is Verdict.OK
    examination = examine_source(folder, num_cameras=3)
    assert examination.motion_verdict is Verdict.BROKEN
    assert "expected 1 to 3, as the bundle was exported; got 4" in str(examination.motion_findings[0])
    assert examination.motion_findings[0].num_frames == 3
