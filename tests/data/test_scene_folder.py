import json

import numpy as np
import pytest

from duospacenet.data.images import write_png
from duospacenet.data.scene_folder import SceneFolder
from duospacenet.jobs.sources import open_source
from duospacenet.runtime.errors import InputError
from examples.nuscenes_scene import has_data, load_frames, write_scene_folder
from tests.helpers.json_edits import deep_copy, delete_at, set_at
from tests.helpers.scene_folders import (
    CALIBRATION,
    EXAMPLE_SCENE,
    INTRINSICS,
    LEFT_IMAGE,
    LOOKING_FORWARD,
    MASK,
    RIGHT_IMAGE,
    assert_frames_equal,
    write_example_scene,
)

# --- Valid scenes -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", [".", "scene.json"])
def test_a_scene_folder_is_read_field_by_field(tmp_path, path):
    source = open_source(str(write_example_scene(tmp_path) / path))
    first, second = source
    assert len(source) == 2
    assert (first.scene, first.token, first.timestamp_s) == ("yard", "first", 10.0)
    assert (second.scene, second.token, second.timestamp_s) == ("street", "", 10.5)
    assert np.array_equal(first.images["LEFT"], LEFT_IMAGE)
    assert np.array_equal(second.images["RIGHT"], RIGHT_IMAGE)
    assert np.array_equal(first.cameras["LEFT"].intrinsics_px, INTRINSICS)
    assert np.array_equal(first.cameras["LEFT"].camera_T_ego, LOOKING_FORWARD)
    assert first.cameras["LEFT"].intrinsics_px.dtype == first.global_T_ego.dtype == np.float64
    assert first.ground_truth is None
    assert second.ground_truth.boxes.tolist() == [[1, 2, 3, 4, 5, 6, 0.7, 8, 9]]
    assert second.ground_truth.classes == ("car",)
    assert np.array_equal(second.ground_truth.maps["drivable_area"], MASK)


def test_a_camera_is_lost_if_its_image_is_null_or_the_frame_does_not_list_it(tmp_path):
    first, second = SceneFolder(write_example_scene(tmp_path))
    assert list(first.cameras) == list(second.cameras) == ["LEFT", "RIGHT"]
    assert first.images["RIGHT"] is None
    assert second.images["LEFT"] is None


def test_a_frame_can_override_single_fields_of_a_calibration(tmp_path):
    first, second = SceneFolder(write_example_scene(tmp_path))
    assert (first.cameras["RIGHT"].width_px, second.cameras["RIGHT"].width_px) == (16, 8)
    assert np.array_equal(second.cameras["RIGHT"].intrinsics_px, INTRINSICS)


def test_the_calibration_can_be_given_in_the_frames_only(tmp_path):
    frame = {**EXAMPLE_SCENE["frames"][0], "cameras": {"ROOF": {"image": "left.png", **CALIBRATION}}}
    (only,) = SceneFolder(write_example_scene(tmp_path, cameras={}, frames=[frame]))
    assert list(only.cameras) == ["ROOF"]
    assert np.array_equal(only.images["ROOF"], LEFT_IMAGE)


def test_an_empty_list_of_boxes_differs_from_unknown_boxes(tmp_path):
    frames = [{**frame, "boxes": boxes} for frame, boxes in zip(EXAMPLE_SCENE["frames"], ([], None), strict=True)]
    del frames[1]["maps"]
    first, second = SceneFolder(write_example_scene(tmp_path, frames=frames))
    assert first.ground_truth.boxes.shape == (0, 9)
    assert first.ground_truth.has_boxes
    assert second.ground_truth is None


def test_an_absolute_image_path_may_be_outside_the_scene_folder(tmp_path):
    write_png(tmp_path / "elsewhere.png", LEFT_IMAGE)
    frame = deep_copy(EXAMPLE_SCENE["frames"][0])
    frame["cameras"]["LEFT"]["image"] = str(tmp_path / "elsewhere.png")
    (only,) = SceneFolder(write_example_scene(tmp_path / "yard", frames=[frame]))
    assert np.array_equal(only.images["LEFT"], LEFT_IMAGE)


def test_relative_image_paths_do_not_depend_on_the_working_directory(tmp_path, monkeypatch):
    write_example_scene(tmp_path / "my yard é")
    monkeypatch.chdir(tmp_path)
    first, _ = SceneFolder("my yard é")
    assert np.array_equal(first.images["LEFT"], LEFT_IMAGE)


def test_iterating_twice_gives_the_same_frames_twice(tmp_path):
    source = SceneFolder(write_example_scene(tmp_path))
    for one, other in zip(source, source, strict=True):
        assert_frames_equal(one, other)


def test_images_are_read_only_when_their_frame_is_requested(tmp_path):
    source = SceneFolder(write_example_scene(tmp_path))
    frames = iter(source)
    (tmp_path / "right.png").unlink()
    assert np.array_equal(next(frames).images["LEFT"], LEFT_IMAGE)
    with pytest.raises(InputError, match=r"right\.png: expected an image file; got no such file"):
        next(frames)


@pytest.mark.skipif(not has_data(), reason="the nuScenes frames are not beside this checkout")
def test_a_scene_folder_of_real_frames_gives_the_same_frames(tmp_path):
    source = SceneFolder(write_scene_folder(tmp_path / "real"))
    for one, other in zip(source, load_frames(), strict=True):
        assert_frames_equal(one, other)


def test_another_scene_may_start_earlier(tmp_path):
    frames = deep_copy(EXAMPLE_SCENE["frames"])
    frames[1]["timestamp_s"] = 3.0
    assert len(list(SceneFolder(write_example_scene(tmp_path, frames=frames)))) == 2


# --- Errors -------------------------------------------------------------------------------------------------------


FLAT = np.diag([1.0, 1.0, 0.0, 1.0]).tolist()
WRONG_FIELDS = {
    "no version": (delete_at("schema_version"), "field schema_version: Field required"),
    "a newer version": (set_at("schema_version", value=2), "field schema_version: Input should be 1; got 2"),
    "no frames": (set_at("frames", value=[]), "field frames: .*at least 1 item"),
    "frames as an object": (set_at("frames", value={}), "field frames: .*; got {}"),
    "an unknown field": (set_at("frame_rate", value=2), "field frame_rate: Extra inputs are not permitted; got 2"),
    "an unknown field of a frame": (set_at("frames", 1, "time", value=2), r"field frames\.1\.time: Extra inputs"),
    "no time stamp": (delete_at("frames", 1, "timestamp_s"), r"field frames\.1\.timestamp_s: Field required"),
    "a time stamp of NaN": (
        set_at("frames", 0, "timestamp_s", value=float("nan")),
        r"field frames\.0\.timestamp_s: expected a finite number in the range of float64; got nan",
    ),
    "an infinite pose": (
        set_at("frames", 0, "global_T_ego", 0, 3, value=float("-inf")),
        r"field frames\.0\.global_T_ego\.0\.3: expected a finite number in the range of float64; got -inf",
    ),
    "a pose of three rows": (
        delete_at("frames", 1, "global_T_ego", 3),
        r"field frames\.1\.global_T_ego\.3: Field req",
    ),
    "a singular pose": (set_at("frames", 1, "global_T_ego", value=FLAT), r"frames\.1: global_T_ego: expected a rota"),
    "no image": (
        delete_at("frames", 0, "cameras", "LEFT", "image"),
        r"frames\.0\.cameras\.LEFT\.image: Field required",
    ),
    "an image as a number": (
        set_at("frames", 0, "cameras", "LEFT", "image", value=3),
        r"frames\.0\.cameras\.LEFT\.image: Input should be a valid string; got 3",
    ),
    "a camera without calibration": (
        set_at("frames", 0, "cameras", "ROOF", value={"image": None}),
        r"frames\.0\.cameras\.ROOF\.width_px: expected a value here or in cameras\.ROOF; got neither",
    ),
    "a frame's camera with half a calibration": (
        set_at("frames", 0, "cameras", "ROOF", value={"image": None, "width_px": 16, "height_px": 8}),
        r"frames\.0\.cameras\.ROOF\.intrinsics_px: expected a value here or in cameras\.ROOF; got neither",
    ),
    "a scene's camera with half a calibration": (
        delete_at("cameras", "LEFT", "camera_T_ego"),
        r"field cameras\.LEFT\.camera_T_ego: Field required",
    ),
    "a width of zero": (
        set_at("cameras", "LEFT", "width_px", value=0),
        r"field cameras\.LEFT\.width_px: Input should be greater than 0; got 0",
    ),
    "a negative focal length": (
        set_at("cameras", "LEFT", "intrinsics_px", 0, 0, value=-10.0),
        r"frames\.0: camera LEFT: intrinsics_px: .* positive focal lengths",
    ),
    "a transposed extrinsic": (
        set_at("cameras", "RIGHT", "camera_T_ego", value=np.transpose(LOOKING_FORWARD).tolist()),
        r"frames\.0: camera RIGHT: camera_T_ego: expected the last row",
    ),
    "no camera at all": (
        lambda scene: (set_at("cameras", value={})(scene), set_at("frames", 0, "cameras", value={})(scene)),
        r"field frames\.0\.cameras: expected at least one, here or in the scene's cameras; got none",
    ),
    "a box without a class": (
        delete_at("frames", 1, "boxes", 0, "class"),
        r"frames\.1\.boxes\.0\.class: Field required",
    ),
    "a box of width zero": (
        set_at("frames", 1, "boxes", 0, "size_wlh_m", 1, value=0.0),
        r"frames\.1\.boxes\.0\.size_wlh_m\.1: Input should be greater than 0; got 0",
    ),
    "the same time stamp twice": (
        lambda scene: (
            delete_at("frames", 1, "scene")(scene),
            set_at("frames", 1, "timestamp_s", value=10.0)(scene),
        ),
        r"field frames\.1\.timestamp_s: expected later than 10\.0 of the frame before; got 10\.0",
    ),
}


@pytest.mark.parametrize("case", WRONG_FIELDS)
def test_a_wrong_field_is_reported_with_the_file_and_its_name(tmp_path, case):
    change, message = WRONG_FIELDS[case]
    scene = deep_copy(EXAMPLE_SCENE)
    change(scene)
    write_example_scene(tmp_path, **scene)
    (tmp_path / "scene.json").write_text(json.dumps(scene))
    with pytest.raises(InputError, match=message) as error:
        SceneFolder(tmp_path)
    assert str(error.value).startswith(f"{tmp_path / 'scene.json'}: field ")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"", "expected JSON; got 0 characters"),
        (b'{"schema_version": 1,', "expected JSON"),
        (b"\xff\xfe{}", "expected UTF-8 text; got UTF-16"),
        (b"[]", "expected a JSON object; got \\[\\]"),
        (b"[" * 200_000, "expected JSON; got arrays or objects that are nested too deeply"),
    ],
)
def test_a_file_that_is_not_a_scene_is_refused(tmp_path, text, message):
    (tmp_path / "scene.json").write_bytes(text)
    with pytest.raises(InputError, match=rf"scene\.json: {message}"):
        SceneFolder(tmp_path)


def test_a_missing_folder_and_a_folder_without_a_scene_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"nowhere: expected a scene folder, or synthetic:SEED.* got no such path"):
        open_source(str(tmp_path / "nowhere"))
    with pytest.raises(InputError, match=r"with scene.json in it; got a folder without it"):
        open_source(str(tmp_path))


def test_an_image_that_does_not_have_the_calibrated_size_is_refused_with_its_path(tmp_path):
    source = SceneFolder(write_example_scene(tmp_path))
    write_png(tmp_path / "left.png", np.ascontiguousarray(LEFT_IMAGE[:, :5]))
    with pytest.raises(InputError, match=r"left\.png: expected 16x8 px, as the calibration says; got 5x8 px"):
        source.frame(0)
