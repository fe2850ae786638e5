"""Cameras with the same pose or the same image."""

import shutil

import numpy as np

from duospacenet.data.images import write_png
from duospacenet.rig import Verdict
from tests.helpers.rigs import change_extrinsics, examine_source, image_name, level_camera, mount_position, write_rig


def test_cameras_at_the_same_position_with_different_directions_are_ok(tmp_path):
    """Such as virtual cameras that are rectified from one wide-angle image."""
    at_left = level_camera(0, mount_position(90)).camera_T_ego
    examination = examine_source(write_rig(tmp_path / "rig", change_extrinsics("FRONT", lambda m: at_left)))
    assert examination.verdict is Verdict.OK


def test_two_cameras_of_the_same_pose_are_found_in_every_frame_even_if_one_is_lost_and_both_move(tmp_path):
    """As in nuScenes, where extrinsics change from frame to frame, because each image has its own time stamp."""

    def same_pose(scene):
        for index, frame in enumerate(scene["frames"]):
            moved = level_camera(90, (1 + 0.1 * index, 0.5, 1.5)).camera_T_ego.tolist()
            for name, image in (("FRONT_LEFT", "FRONT"), ("LEFT", "LEFT")):
                frame["cameras"][name] = {"image": image_name(image, index), "camera_T_ego": moved}
            del frame["cameras"]["FRONT"]
        scene["cameras"]["FRONT_LEFT"] = scene["cameras"].pop("FRONT")
        scene["frames"][0]["cameras"]["LEFT"]["image"] = None

    folder = write_rig(tmp_path / "rig", same_pose)
    views = examine_source(folder).views
    for name, partner in (("LEFT", "FRONT_LEFT"), ("FRONT_LEFT", "LEFT")):
        (finding,) = views[name].findings
        assert (finding.subject, finding.verdict, finding.num_frames) == (f"pose compared with {partner}", "broken", 3)


def test_images_with_the_same_pixels_in_different_files_are_found(tmp_path):
    folder = write_rig(tmp_path / "rig")
    shutil.copy(folder / "LEFT.png", folder / "FRONT.png")
    examination = examine_source(folder)
    assert "the same pixels as LEFT" in str(examination.views["FRONT"].findings[0])
    assert examination.views["LEFT"].verdict is Verdict.BROKEN
    write_png(folder / "FRONT.png", np.zeros((80, 160, 3), np.uint8))
    write_png(folder / "LEFT.png", np.zeros((80, 160, 3), np.uint8))
    assert examine_source(folder).verdict is Verdict.OK  # images at night may all be black
