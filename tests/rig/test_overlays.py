"""The pictures of an examination: texts, crop, fields of view and file names."""

import numpy as np
import pytest

from duospacenet.drawing import footer
from duospacenet.drawing.coverage_map import COUNT_COLOURS, SIZE_PX
from duospacenet.jobs.sources import open_recording
from duospacenet.rig import RigRequirements, examine
from duospacenet.rig.overlays import (
    crop_corners,
    draw_camera_overlay,
    draw_rig_coverage,
    field_of_view_wedge,
    overlay_paths,
)
from tests.helpers.rigs import UPPER_HALF_CROP, change_extrinsics, change_intrinsics, level_camera, write_rig


def examine_first_frame(folder):
    return examine(open_recording(str(folder)), RigRequirements(), 1)


def test_the_picture_of_a_broken_camera_shows_the_cause(tmp_path, monkeypatch):
    texts = []
    monkeypatch.setattr(footer, "draw_text", lambda picture, text, *_: texts.append(text))
    examination = examine_first_frame(write_rig(tmp_path / "rig", change_extrinsics("FRONT", np.linalg.inv)))
    causes = " ".join(finding.cause for finding in examination.views["FRONT"].findings)
    assert "ego_T_camera" in causes
    draw_camera_overlay("FRONT", examination)
    assert "broken, frame 0: looks " in " ".join(texts)
    assert causes in " ".join(texts)
    texts.clear()
    draw_camera_overlay("LEFT", examination)
    assert "ok, frame 0: looks 90.0 degrees to the left" in " ".join(texts)
    assert "ego_T_camera" not in " ".join(texts)


def test_the_picture_of_a_broken_camera_is_higher_for_its_findings(tmp_path):
    examination = examine_first_frame(write_rig(tmp_path / "rig", change_extrinsics("FRONT", np.linalg.inv)))
    heights = {name: draw_camera_overlay(name, examination).shape[0] for name in examination.views}
    assert heights["FRONT"] >= heights["LEFT"] + 24
    assert heights["LEFT"] == heights["BACK"]
    assert draw_rig_coverage(examination).shape[1] == SIZE_PX


def test_the_coverage_map_of_a_rig_with_only_broken_cameras_is_empty(tmp_path):
    def break_all(scene):
        for name in scene["cameras"]:
            change_intrinsics(name, np.transpose)(scene)

    examination = examine_first_frame(write_rig(tmp_path / "rig", break_all))
    assert tuple(draw_rig_coverage(examination)[3, 3].tolist()) == COUNT_COLOURS["0"]


@pytest.mark.parametrize("azimuth_deg", [0, 90, 180, -60])
def test_a_wedge_has_the_direction_and_the_angle_of_the_camera(azimuth_deg):
    wedge = field_of_view_wedge("a", level_camera(azimuth_deg, (1.0, 0.5, 1.5)))
    angles = np.degrees([wedge.left_rad, wedge.middle_rad, wedge.right_rad]) - azimuth_deg
    np.testing.assert_allclose((angles + 180) % 360 - 180, [45, 0, -45], atol=1e-9)
    np.testing.assert_allclose(wedge.position_m, [1.0, 0.5])


def test_the_crop_is_given_in_pixels_of_the_image():
    corners = crop_corners(level_camera(0), UPPER_HALF_CROP)
    np.testing.assert_allclose(corners, [(0, 40), (160, 40), (160, 80), (0, 80)])


def test_file_names_of_unusual_camera_names_are_safe_and_distinct():
    names = ["FRONT", "front", "../../etc/passwd", "a/b", "a b", "", ".", "Кам", "x" * 500, "CON.png"]
    paths = overlay_paths(names)
    assert paths["FRONT"] == "cameras/FRONT.png"
    assert paths["../../etc/passwd"] == "cameras/______etc_passwd.png"
    assert len({path.lower() for path in paths.values()}) == len(names)
    for path in paths.values():
        assert path.startswith("cameras/")
        assert path.count("/") == path.count(".") == 1
        assert len(path) < 120
