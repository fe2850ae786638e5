"""Sources that are looked at without being believed; and that nothing else became laxer."""

import numpy as np
import pytest

from duospacenet.data.images import read_image_size, write_png
from duospacenet.data.scene_folder import SceneFolder
from duospacenet.jobs.sources import open_recording, open_source
from duospacenet.rig.recording import spread
from duospacenet.runtime.errors import InputError
from duospacenet.synthetic.drive import SyntheticDrive
from tests.helpers.rigs import change_extrinsics, change_times, write_rig


def mirrored(scene):
    change_extrinsics("FRONT", lambda m: np.diag([-1.0, 1, 1, 1]) @ m)(scene)


@pytest.mark.parametrize("damage", [mirrored, change_times(lambda t: -t), change_times(lambda t: 1e12 * t)])
def test_a_broken_scene_is_refused_by_a_source_and_opened_by_a_recording(tmp_path, damage):
    folder = write_rig(tmp_path / "rig", damage)
    with pytest.raises(InputError):
        open_source(str(folder))
    with pytest.raises(InputError):
        SceneFolder(folder)
    assert len(open_recording(str(folder))) == 3


def without_intrinsics(scene):
    del scene["cameras"]["FRONT"]["intrinsics_px"]


def with_unknown_field(scene):
    scene["cameras"]["FRONT"]["distortion"] = [0.1]


def with_nan(scene):
    scene["cameras"]["FRONT"]["intrinsics_px"][0][0] = float("nan")


@pytest.mark.parametrize("damage", [without_intrinsics, with_unknown_field, with_nan])
def test_a_scene_of_another_structure_is_refused_by_both(tmp_path, damage):
    folder = write_rig(tmp_path / "rig", damage)
    with pytest.raises(InputError, match=r"scene\.json: field cameras\.FRONT"):
        open_recording(str(folder))


def test_a_missing_calibration_of_a_frame_is_refused_when_its_turn_comes(tmp_path):
    folder = write_rig(tmp_path / "rig", lambda scene: scene["frames"][1]["cameras"].update(ROOF={"image": None}))
    with pytest.raises(InputError, match=r"frames\.1\.cameras\.ROOF\.width_px"):
        open_recording(str(folder)).frame_without_images(1)


def test_a_blind_frame_of_a_drawn_drive_is_the_frame_without_its_pictures():
    recording, frame = open_recording("synthetic:4:3"), SyntheticDrive(4, 3).frame(2)
    blind = recording.frame_without_images(2)
    assert (blind.timestamp_s, blind.scene) == (frame.timestamp_s, frame.scene)
    assert np.array_equal(blind.global_T_ego, frame.global_T_ego)
    assert set(blind.images) == set(frame.images)
    assert not any(image is not None for image in blind.images.values())
    camera_images = recording.camera_images(2)
    assert all(np.array_equal(camera_images[name].image, image) for name, image in frame.images.items())
    assert len(recording) == 3


def test_a_picture_of_another_size_is_refused_and_shown_all_the_same(tmp_path):
    folder = write_rig(tmp_path / "rig")
    write_png(folder / "FRONT.png", np.full((20, 30, 3), 7, np.uint8))
    (folder / "LEFT.png").write_bytes((folder / "LEFT.png").read_bytes()[:500])
    camera_images = open_recording(str(folder)).camera_images(0)
    assert (camera_images["FRONT"].size_px, camera_images["FRONT"].image.shape) == ((30, 20), (20, 30, 3))
    assert "expected 160x80 px" in str(camera_images["FRONT"].error)
    assert camera_images["LEFT"].image is None
    assert "without its end" in str(camera_images["LEFT"].error)
    assert camera_images["BACK"].error is None


def test_the_size_of_an_image_is_width_and_height_of_its_header(tmp_path):
    write_png(tmp_path / "a.png", np.zeros((20, 30, 3), np.uint8))
    assert read_image_size(tmp_path / "a.png") == (30, 20)
    with pytest.raises(InputError, match="no such file"):
        read_image_size(tmp_path / "b.png")


def test_frames_are_spread_from_the_first_to_the_last():
    assert spread(9, 3) == [0, 4, 8]
    assert spread(9, 1) == [0]
    assert spread(2, 8) == [0, 1]
    assert spread(1, 8) == [0]
