import json

import numpy as np
import pytest

from duospacenet.data.images import write_png
from duospacenet.data.scene_folder import SceneFolder
from duospacenet.jobs.sources import open_recording, open_source
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


def scene_with_paths(folder, image, mask):
    frame = deep_copy(EXAMPLE_SCENE["frames"][1])
    frame["cameras"]["RIGHT"]["image"], frame["maps"]["drivable_area"] = image, mask
    return write_example_scene(folder, frames=[frame])


@pytest.mark.parametrize("kind", ["image", "mask"])
@pytest.mark.parametrize(
    "path",
    ["/etc/hostname", "../other.png", "images/../../other.png", "..", "./.././yard/../other.png", "{tmp}/other.png"],
)
def test_a_path_that_leads_out_of_the_scene_folder_is_refused_unless_the_folder_is_trusted(tmp_path, path, kind):
    paths = {"image": "right.png", "mask": "mask.png"} | {kind: path.format(tmp=tmp_path)}
    folder = scene_with_paths(tmp_path / "yard", **paths)
    field = {"image": r"cameras\.RIGHT\.image", "mask": r"maps\.drivable_area"}[kind]
    for open_it in (open_source, open_recording, SceneFolder):
        with pytest.raises(InputError, match=rf"frames\.0\.{field}: expected a path inside .* trusted:/"):
            open_it(folder)
    open_source(f"trusted:{folder}")
    open_recording(f"trusted:{folder}")


def test_a_trusted_folder_reads_images_and_masks_from_anywhere(tmp_path):
    write_png(tmp_path / "elsewhere.png", RIGHT_IMAGE)
    write_png(tmp_path / "mask.png", MASK.astype(np.uint8))
    scene_with_paths(tmp_path / "yard", image=str(tmp_path / "elsewhere.png"), mask="../mask.png")
    (only,) = open_source(f"trusted:{tmp_path / 'yard'}")
    assert np.array_equal(only.images["RIGHT"], RIGHT_IMAGE)
    assert np.array_equal(only.ground_truth.maps["drivable_area"], MASK)


def test_paths_inside_the_folder_may_be_absolute_or_have_dots_or_pass_links(tmp_path):
    yard = tmp_path / "yard"
    (tmp_path / "data").mkdir()
    write_png(tmp_path / "data" / "right.png", RIGHT_IMAGE)
    yard.mkdir()
    (yard / "images").mkdir()
    (yard / "linked").symlink_to(tmp_path / "data")
    (yard / "link.png").symlink_to("../data/right.png")
    for path in ("linked/right.png", "link.png", "./right.png", "images/../right.png", str(yard / "right.png")):
        scene_with_paths(yard, image=path, mask="mask.png")
        (only,) = SceneFolder(yard)
        assert np.array_equal(only.images["RIGHT"], RIGHT_IMAGE)


@pytest.mark.parametrize(
    "name", ["distortion", "dist_coeffs", "D", "k1", "P2", "xi", "distortion_coefficients", "cam_dist"]
)
@pytest.mark.parametrize("place", [("cameras", "LEFT"), ("frames", 0, "cameras", "LEFT")])
def test_lens_distortion_is_refused_with_the_way_to_rectify_the_images(tmp_path, name, place):
    scene = deep_copy(EXAMPLE_SCENE)
    set_at(*place, name, value=[-0.3, 0.1, 0, 0, 0])(scene)
    folder = write_example_scene(tmp_path, **scene)
    field = r"\.".join(map(str, place))
    message = rf"field {field}: expected images without lens distortion; got {name}=\[-0\.3, .*Rectify the images"
    for open_it in (open_source, open_recording):
        with pytest.raises(InputError, match=message) as refusal:
            open_it(folder)
    assert "as intrinsics_px, and remove the field" in str(refusal.value)


@pytest.mark.parametrize("value", [None, 0, [], [0, 0.0, 0, 0]])
def test_a_distortion_of_zero_is_refused_with_the_advice_to_remove_the_field(tmp_path, value):
    scene = deep_copy(EXAMPLE_SCENE)
    set_at("cameras", "LEFT", "distortion", value=value)(scene)
    with pytest.raises(InputError, match=r"The images have no distortion, so remove the field\.$"):
        SceneFolder(write_example_scene(tmp_path, **scene))


@pytest.mark.parametrize(
    ("name", "value", "is_distortion"),
    [
        ("camera_model", "fisheye", True),
        ("model", "OPENCV", True),
        ("camera_model", "pinhole", False),
        ("K", [[1, 0, 0], [0, 1, 0], [0, 0, 1]], False),
        ("distance_m", 3, False),
    ],
)
def test_a_lens_model_is_refused_as_distortion_unless_it_is_a_pinhole(tmp_path, name, value, is_distortion):
    scene = deep_copy(EXAMPLE_SCENE)
    set_at("cameras", "LEFT", name, value=value)(scene)
    with pytest.raises(InputError, match="without lens distortion" if is_distortion else "Extra inputs"):
        SceneFolder(write_example_scene(tmp_path, **scene))


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
    "an escape sequence in a camera's name": (
        set_at("cameras", "\x1b[2J", value=deep_copy(CALIBRATION)),
        r"field cameras\.\\x1b\[2J\.\[key\]: expected text without control characters; got '\\x1b\[2J'",
    ),
    "an escape sequence of one byte in a scene's name": (set_at("scene", value="\x9b2J"), "field scene: expected text"),
    "a line end in a token": (set_at("frames", 0, "token", value="a\nb"), r"frames\.0\.token: expected text without"),
    "reversed text in a class name": (
        set_at("frames", 1, "boxes", 0, "class", value="\u202erac"),
        r"frames\.1\.boxes\.0\.class: expected text without control characters; got '\\u202erac'",
    ),
    "NUL in an image path": (
        set_at("frames", 0, "cameras", "LEFT", "image", value="a\0.png"),
        r"frames\.0\.cameras\.LEFT\.image: expected text without control",
    ),
    "a lone surrogate in a camera's name": (
        set_at("cameras", "\ud800", value=deep_copy(CALIBRATION)),
        r"field cameras: expected a string that UTF-8 can encode; got the lone surrogate in '\\ud800'",
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
    with pytest.raises(
        InputError, match=r"nowhere: expected a scene folder, nuscenes:ROOT or synthetic:SEED.* got no such path"
    ):
        open_source(str(tmp_path / "nowhere"))
    with pytest.raises(InputError, match=r"with scene.json in it; got a folder without it\.$"):
        open_source(str(tmp_path))


def test_a_nuscenes_root_without_its_prefix_is_refused_with_the_name_to_write(tmp_path):
    version = tmp_path / "v1.0-mini"
    version.mkdir()
    for table in ("scene", "sample_data"):
        (version / f"{table}.json").write_text("[]")
    with pytest.raises(InputError, match=rf"For a nuScenes root, write nuscenes:{tmp_path}\.$"):
        open_source(str(tmp_path))
    for name in (version, version / "scene.json"):
        with pytest.raises(InputError, match=rf"tables of a nuScenes root\. Write nuscenes:{tmp_path}@v1\.0-mini\.$"):
            open_source(str(name))


def test_an_image_that_does_not_have_the_calibrated_size_is_refused_with_its_path(tmp_path):
    source = SceneFolder(write_example_scene(tmp_path))
    write_png(tmp_path / "left.png", np.ascontiguousarray(LEFT_IMAGE[:, :5]))
    with pytest.raises(InputError, match=r"left\.png: expected 16x8 px, as the calibration says; got 5x8 px"):
        source.frame(0)
