import json
from dataclasses import replace

import numpy as np
import pytest

from duospacenet.data.scene_folder import SceneFolder
from duospacenet.data.scene_writer import write_scene
from duospacenet.runtime.errors import InputError, OutputError
from tests.helpers.json_edits import deep_copy
from tests.helpers.scene_folders import EXAMPLE_SCENE, assert_frames_equal, write_example_scene
from tests.helpers.streams import lose_cameras, turn_cameras


def test_written_frames_are_read_back_unchanged(tmp_path, frames):
    write_scene(tmp_path / "drive", iter(frames))
    source = SceneFolder(tmp_path / "drive")
    assert len(source) == len(frames)
    for one, other in zip(source, frames, strict=True):
        assert_frames_equal(one, other)


def test_lost_cameras_new_scenes_and_changed_calibrations_are_read_back_unchanged(tmp_path, frames, other_frames):
    one_camera = replace(
        frames[3],
        images={"CAM_BACK": frames[3].images["CAM_BACK"]},
        cameras={"CAM_BACK": frames[3].cameras["CAM_BACK"]},
        ground_truth=None,
    )
    written = [frames[0], lose_cameras(frames[1], "CAM_FRONT"), turn_cameras(frames[2]), one_camera, *other_frames[:2]]
    write_scene(tmp_path / "drive", written)
    for one, other in zip(SceneFolder(tmp_path / "drive"), written, strict=True):
        assert_frames_equal(one, other)


def test_maps_without_boxes_are_read_back_as_maps_without_boxes(tmp_path):
    frame = {name: value for name, value in EXAMPLE_SCENE["frames"][1].items() if name != "boxes"}
    original = SceneFolder(write_example_scene(tmp_path / "yard", frames=[frame]))
    write_scene(tmp_path / "again", original)
    for source in (original, SceneFolder(tmp_path / "again")):
        assert list(source.frame(0).ground_truth.maps) == list(EXAMPLE_SCENE["frames"][1]["maps"])
        assert not source.frame(0).ground_truth.has_boxes
        assert source.ground_truth_without_maps(0) is None


def test_a_velocity_of_null_is_nan_and_is_read_back_as_nan(tmp_path):
    frame = deep_copy(EXAMPLE_SCENE["frames"][1])
    frame["boxes"].append({**frame["boxes"][0], "velocity_m_s": None})
    (read,) = SceneFolder(write_example_scene(tmp_path / "yard", frames=[frame]))
    assert np.isnan(read.ground_truth.boxes).tolist() == [[False] * 9, [False] * 7 + [True] * 2]
    write_scene(tmp_path / "again", [read])
    assert_frames_equal(SceneFolder(tmp_path / "again").frame(0), read)


def test_a_calibration_shared_by_all_frames_is_written_once(tmp_path, frames):
    write_scene(tmp_path / "drive", [frames[0], lose_cameras(frames[1], "CAM_FRONT")])
    scene = json.loads((tmp_path / "drive" / "scene.json").read_text())
    assert set(scene["cameras"]) == set(frames[0].cameras)
    assert scene["frames"][0]["cameras"]["CAM_BACK"] == {"image": "images/CAM_BACK/000000.png"}
    assert scene["frames"][1]["cameras"]["CAM_FRONT"] == {"image": None}


def test_nothing_remains_on_disk_after_an_invalid_frame(tmp_path, frames):
    bad = replace(frames[1], timestamp_s=np.nan)
    with pytest.raises(InputError, match="timestamp_s"):
        write_scene(tmp_path / "drive", [frames[0], bad])
    with pytest.raises(InputError, match="at least one frame"):
        write_scene(tmp_path / "drive", [])
    with pytest.raises(InputError, match=r"expected names that are valid as folder names; got '\.\./x'"):
        images, cameras = ({"../x": by_camera["CAM_BACK"]} for by_camera in (frames[0].images, frames[0].cameras))
        write_scene(tmp_path / "drive", [replace(frames[0], images=images, cameras=cameras)])
    with pytest.raises(InputError, match="finite positions, sizes and yaws"):
        unknown = replace(frames[0].ground_truth, boxes=np.full_like(frames[0].ground_truth.boxes, np.nan))
        write_scene(tmp_path / "drive", [replace(frames[0], ground_truth=unknown)])
    for velocity in ((np.inf, np.inf), (np.nan, 1.0), (0.0, -np.inf)):
        boxes = np.array([[*frames[0].ground_truth.boxes[0, :7], *velocity]])
        ground_truth = replace(frames[0].ground_truth, boxes=boxes, classes=frames[0].ground_truth.classes[:1])
        with pytest.raises(InputError, match="frame 0: expected finite velocities, or NaN twice if unknown"):
            write_scene(tmp_path / "drive", [replace(frames[0], ground_truth=ground_truth)])
    assert list(tmp_path.iterdir()) == []


def test_nothing_remains_on_disk_after_an_interruption(tmp_path, frames):
    def interrupted():
        yield frames[0]
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_scene(tmp_path / "drive", interrupted())
    assert list(tmp_path.iterdir()) == []


def test_an_existing_folder_is_refused_and_not_changed(tmp_path, frames):
    write_example_scene(tmp_path / "yard")
    before = sorted(path.name for path in (tmp_path / "yard").iterdir())
    with pytest.raises(OutputError, match=r"yard: expected a new folder; it exists already"):
        write_scene(tmp_path / "yard", frames)
    assert sorted(path.name for path in (tmp_path / "yard").iterdir()) == before


def test_a_folder_that_cannot_be_created_is_refused(tmp_path, frames):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="file/drive: cannot be written"):
        write_scene(tmp_path / "file" / "drive", frames[:1])


def test_an_image_size_may_be_a_number_of_numpy(tmp_path, frames):
    sizes = {name: replace(camera, width_px=np.int64(camera.width_px)) for name, camera in frames[0].cameras.items()}
    write_scene(tmp_path / "drive", [replace(frames[0], cameras=sizes)])
    assert_frames_equal(SceneFolder(tmp_path / "drive").frame(0), frames[0])


@pytest.mark.parametrize("field", ["scene", "token", "classes"])
def test_names_that_a_scene_folder_may_not_have_are_refused(tmp_path, frames, field):
    if field == "classes":
        names = ("\x1b[2J", *frames[0].ground_truth.classes[1:])
        frame = replace(frames[0], ground_truth=replace(frames[0].ground_truth, classes=names))
    else:
        frame = replace(frames[0], **{field: "\x1b[2J"})
    with pytest.raises(InputError, match=r"without control characters; got '\\x1b\[2J'\. Rename it"):
        write_scene(tmp_path / "drive", [frame])
    assert list(tmp_path.iterdir()) == []
