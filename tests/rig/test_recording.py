"""Recordings read broken sources without validation, and the other readers still refuse them."""

import numpy as np
import pytest

from duospacenet.data.images import write_png
from duospacenet.data.scene_folder import SceneFolder
from duospacenet.jobs.sources import open_recording, open_source
from duospacenet.rig.recording import CameraImage, FileRecording, SourceRecording, evenly_spaced
from duospacenet.runtime.errors import InputError
from duospacenet.synthetic.drive import SyntheticDrive
from tests.helpers.rigs import AZIMUTHS_DEG, change_extrinsics, change_times, write_rig


def mirror_camera(scene):
    change_extrinsics("FRONT", lambda m: np.diag([-1.0, 1, 1, 1]) @ m)(scene)


@pytest.mark.parametrize("damage", [mirror_camera, change_times(lambda t: -t), change_times(lambda t: 1e12 * t)])
def test_a_broken_scene_is_refused_by_a_source_and_opened_as_a_recording(tmp_path, damage):
    folder = write_rig(tmp_path / "rig", damage)
    with pytest.raises(InputError):
        open_source(str(folder))
    with pytest.raises(InputError):
        SceneFolder(folder)
    assert len(open_recording(str(folder))) == 3


def remove_intrinsics(scene):
    del scene["cameras"]["FRONT"]["intrinsics_px"]


def add_unknown_field(scene):
    scene["cameras"]["FRONT"]["distortion"] = [0.1]


def set_nan(scene):
    scene["cameras"]["FRONT"]["intrinsics_px"][0][0] = float("nan")


@pytest.mark.parametrize("damage", [remove_intrinsics, add_unknown_field, set_nan])
def test_a_scene_with_wrong_fields_is_refused_by_both(tmp_path, damage):
    folder = write_rig(tmp_path / "rig", damage)
    with pytest.raises(InputError, match=r"scene\.json: field cameras\.FRONT"):
        open_recording(str(folder))


def test_a_missing_calibration_of_a_later_frame_is_refused_when_that_frame_is_read(tmp_path):
    folder = write_rig(tmp_path / "rig", lambda scene: scene["frames"][1]["cameras"].update(ROOF={"image": None}))
    with pytest.raises(InputError, match=r"frames\.1\.cameras\.ROOF\.width_px"):
        open_recording(str(folder)).frame_without_images(1)


def test_a_source_recording_has_the_frames_and_images_of_its_source():
    recording, frame = open_recording("synthetic:4:3"), SyntheticDrive(4, 3).frame(2)
    assert isinstance(recording, SourceRecording)
    without_images = recording.frame_without_images(2)
    assert (without_images.timestamp_s, without_images.scene) == (frame.timestamp_s, frame.scene)
    assert np.array_equal(without_images.global_T_ego, frame.global_T_ego)
    assert set(without_images.images) == set(frame.images)
    assert not any(image is not None for image in without_images.images.values())
    camera_images = recording.camera_images(2)
    assert all(np.array_equal(camera_images[name].image, image) for name, image in frame.images.items())
    assert len(recording) == 3


def lose_first_front(scene):
    scene["frames"][0]["cameras"]["FRONT"]["image"] = None


def add_roof_to_second_frame(scene):
    scene["frames"][1]["cameras"]["ROOF"] = scene["cameras"]["FRONT"] | {"image": None}


def recordings(tmp_path, damage=lambda scene: None):
    """The same scene folder as a FileRecording and as a SourceRecording."""
    folder = SceneFolder(write_rig(tmp_path / "rig", damage))
    return FileRecording(folder), SourceRecording(folder)


def test_both_recordings_of_a_scene_folder_have_the_same_frames_and_images(tmp_path):
    from_folder, from_source = recordings(tmp_path)
    assert len(from_folder) == len(from_source) == 3
    assert from_folder.camera_names() == from_source.camera_names() == list(AZIMUTHS_DEG)
    for name, image in from_folder.camera_images(1).items():
        assert np.array_equal(image.image, from_source.camera_images(1)[name].image)
        assert image.size_px == from_source.camera_images(1)[name].size_px == (160, 80)


def test_a_lost_camera_has_an_empty_image_in_both_recordings(tmp_path):
    for recording in recordings(tmp_path, lose_first_front):
        assert recording.camera_images(0)["FRONT"] == CameraImage()
        assert recording.camera_images(1)["FRONT"].size_px == (160, 80)


def test_cameras_that_appear_in_later_frames_are_named(tmp_path):
    for recording in recordings(tmp_path, add_roof_to_second_frame):
        assert recording.camera_names() == [*AZIMUTHS_DEG, "ROOF"]


def test_an_image_of_another_size_has_an_error_and_is_read_nevertheless(tmp_path):
    folder = write_rig(tmp_path / "rig")
    write_png(folder / "FRONT.png", np.full((20, 30, 3), 7, np.uint8))
    (folder / "LEFT.png").write_bytes((folder / "LEFT.png").read_bytes()[:500])
    camera_images = open_recording(str(folder)).camera_images(0)
    assert (camera_images["FRONT"].size_px, camera_images["FRONT"].image.shape) == ((30, 20), (20, 30, 3))
    assert "expected 160x80 px" in str(camera_images["FRONT"].error)
    assert camera_images["LEFT"].image is None
    assert "500 bytes without its end" in str(camera_images["LEFT"].error)
    assert camera_images["BACK"].error is None


def test_frames_are_evenly_spaced_from_the_first_to_the_last():
    assert evenly_spaced(9, 3) == [0, 4, 8]
    assert evenly_spaced(9, 1) == [0]
    assert evenly_spaced(2, 8) == [0, 1]
    assert evenly_spaced(1, 8) == [0]
