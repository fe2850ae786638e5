"""Examinations of whole rigs: sound rigs are ok, and the views show the right frames."""

import numpy as np
import pytest

from duospacenet.data.images import write_png
from duospacenet.rig import Verdict
from duospacenet.rig.rig_report import rig_report_dict
from duospacenet.runtime.bundle.manifest import PerceptionRange
from duospacenet.runtime.geometry import inverse
from examples.nuscenes_scene import has_data, write_scene_folder
from tests.helpers.rigs import change_extrinsics, examine_source, image_name, level_camera, mount_position, write_rig


def test_a_camera_that_sees_no_voxel_is_suspect(tmp_path):
    ahead = PerceptionRange(size=(32, 32, 2), lower_m=(5.0, -51.2, -3.0), upper_m=(51.2, 51.2, 5.0))
    views = examine_source(write_rig(tmp_path / "rig"), perception=ahead).views
    assert {name: [finding.subject for finding in view.findings] for name, view in views.items()} == {
        "FRONT": [],
        "LEFT": [],
        "BACK": ["coverage"],
        "RIGHT": [],
    }
    assert views["BACK"].verdict is Verdict.SUSPECT
    assert "none in view of BACK" in str(views["BACK"].findings[0])


@pytest.mark.parametrize(
    ("size_px", "cause"),
    [
        ((80, 160), "Width and height are swapped"),
        ((320, 160), "scaled by 2 after the calibration"),
        ((160, 60), "The image was cropped after the calibration"),
    ],
)
def test_an_image_of_another_size_than_its_calibration_is_broken(tmp_path, size_px, cause):
    folder = write_rig(tmp_path / "rig")
    for index in range(3):
        write_png(folder / image_name("FRONT", index), np.full((size_px[1], size_px[0], 3), 9, np.uint8))
    (finding,) = examine_source(folder).views["FRONT"].findings
    assert (finding.subject, finding.verdict, finding.num_frames) == ("image", "broken", 3)
    assert finding.expected == "160x80 px, as the calibration says"
    assert finding.got == f"{size_px[0]}x{size_px[1]} px"
    assert cause in finding.cause


@pytest.mark.parametrize("seed", range(6))
def test_synthetic_rigs_are_ok(seed):
    examination = examine_source(f"synthetic:{seed}:4", num_frames=1)
    assert examination.verdict is Verdict.OK
    assert all(view.camera_image.image is not None for view in examination.views.values())
    assert examination.coverage.shares_by_count()["0"] < 0.05


@pytest.mark.skipif(not has_data(), reason="the nuScenes frames are not beside this checkout")
def test_the_real_rig_is_ok_even_though_its_calibration_changes_from_frame_to_frame(tmp_path):
    examination = examine_source(write_scene_folder(tmp_path / "scene"))
    assert examination.verdict is Verdict.OK
    assert {view.num_calibrations for view in examination.views.values()} == {4}
    assert examination.blind_sectors == ()
    # The nuScenes paper states 70 degrees, and 110 for the back camera. f = 1266 px and 809 px with 1600 px give 65
    # and 90 degrees.
    cameras = rig_report_dict("", examination, dict.fromkeys(examination.views, ""))["cameras"]
    assert cameras["CAM_FRONT"]["field_of_view_deg"]["horizontal"] == pytest.approx(64.6, abs=1)
    assert cameras["CAM_BACK"]["field_of_view_deg"]["horizontal"] == pytest.approx(89.4, abs=1)
    assert cameras["CAM_FRONT_LEFT"]["azimuth_deg"] == pytest.approx(55, abs=3)


def test_broken_cameras_are_left_out_of_the_coverage(tmp_path):
    whole = examine_source(write_rig(tmp_path / "whole"))
    damaged = examine_source(write_rig(tmp_path / "damaged", change_extrinsics("LEFT", inverse)))
    assert list(damaged.coverage.voxels) == ["FRONT", "BACK", "RIGHT"]
    assert damaged.coverage.voxel_share("FRONT") == whole.coverage.voxel_share("FRONT")
    assert whole.blind_sectors == ()
    # FRONT's left border starts 1.5 m ahead of the origin. A ray at angle a crosses it after 1.5 / (cos a - sin a) m:
    # at 42.5 degrees after 24.3 of 69.4 m, at 43.5 degrees after 40.5 of 70.6 m. A ray leaves BACK's view after
    # 0.5 / (sin a + cos a) m: at 133.5 degrees after 13.5 of 70.6 m, at 134.5 degrees after 40.4 of 71.8 m.
    assert damaged.blind_sectors == ((43, 134),)


def test_the_view_of_a_problem_in_one_frame_shows_that_frame(tmp_path):
    view = examine_source(write_rig(tmp_path / "rig", invert_extrinsics_in_one_frame), num_frames=1).views["FRONT"]
    assert view.frame == 1
    assert [(finding.frame, finding.num_frames) for finding in view.findings] == [(1, 1)]
    assert view.num_calibrations == 2
    always = examine_source(write_rig(tmp_path / "always", change_extrinsics("FRONT", inverse))).views["FRONT"]
    assert [(finding.frame, finding.num_frames) for finding in always.findings] == [(0, 3)]


def test_the_view_of_a_camera_shows_a_frame_with_an_image(tmp_path):
    def lose_first_image(scene):
        scene["frames"][0]["cameras"]["FRONT"]["image"] = None

    view = examine_source(write_rig(tmp_path / "rig", lose_first_image)).views["FRONT"]
    assert (view.frame, view.verdict, view.camera_image.size_px) == (1, Verdict.OK, (160, 80))


def test_images_are_checked_in_as_many_frames_as_requested(tmp_path):
    folder = write_rig(tmp_path / "rig")
    assert list(examine_source(folder, num_frames=1).image_sizes) == [0]
    assert list(examine_source(folder, num_frames=2).image_sizes) == [0, 2]
    assert examine_source(folder).image_sizes[1]["LEFT"] == ((160, 80), (160, 80))


def invert_extrinsics_in_one_frame(scene):
    scene["frames"][1]["cameras"]["FRONT"]["camera_T_ego"] = inverse(
        level_camera(0, mount_position(0)).camera_T_ego
    ).tolist()
