import json
from dataclasses import replace

import numpy as np
import pytest

from duospacenet.data.images import write_png
from duospacenet.data.scene_folder import SceneFolder, write_scene
from duospacenet.jobs.sources import open_source
from duospacenet.runtime import Camera, Frame, GroundTruth
from duospacenet.runtime.errors import InputError, OutputError
from examples.nuscenes_scene import is_here, load_frames, write_scene_folder
from tests.helpers.streams import lose, turned_rig

INTRINSICS = [[10.0, 0.0, 8.0], [0.0, 10.0, 4.0], [0.0, 0.0, 1.0]]
AHEAD = [[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 1.5], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
AT_ORIGIN = np.eye(4).tolist()
CALIBRATION = {"width_px": 16, "height_px": 8, "intrinsics_px": INTRINSICS, "camera_T_ego": AHEAD}
SCENE = {
    "schema_version": 1,
    "scene": "yard",
    "cameras": {"LEFT": CALIBRATION, "RIGHT": CALIBRATION},
    "frames": [
        {
            "timestamp_s": 10.0,
            "token": "first",
            "global_T_ego": AT_ORIGIN,
            "cameras": {"LEFT": {"image": "left.png"}, "RIGHT": {"image": None}},
        },
        {
            "timestamp_s": 10.5,
            "scene": "street",
            "global_T_ego": AT_ORIGIN,
            "cameras": {"RIGHT": {"image": "right.png", "width_px": 8}},
            "boxes": [
                {
                    "class": "car",
                    "center_m": [1, 2, 3],
                    "size_wlh_m": [4, 5, 6],
                    "yaw_rad": 0.7,
                    "velocity_m_s": [8, 9],
                }
            ],
            "maps": {"drivable_area": "mask.png"},
        },
    ],
}
LEFT_IMAGE = np.arange(16 * 8 * 3, dtype=np.uint8).reshape(8, 16, 3)
RIGHT_IMAGE = LEFT_IMAGE[:, ::2] + 7
MASK = np.eye(5, 4, 1) > 0


def copy_of(value):
    """A copy whose parts are all its own, also those that the value holds twice."""
    return json.loads(json.dumps(value))


def write_yard(folder, **changes):
    """The scene above with its images; changes are to fields at its top."""
    folder.mkdir(parents=True, exist_ok=True)
    write_png(folder / "left.png", LEFT_IMAGE)
    write_png(folder / "right.png", np.ascontiguousarray(RIGHT_IMAGE))
    write_png(folder / "mask.png", MASK.astype(np.uint8))
    (folder / "scene.json").write_text(json.dumps({**SCENE, **changes}))
    return folder


def assert_same_frame(one: Frame, other: Frame):
    """Every field equal, images and numbers bit for bit, cameras in the same order."""
    assert (one.timestamp_s, one.scene, one.token) == (other.timestamp_s, other.scene, other.token)
    assert one.global_T_ego.tobytes() == other.global_T_ego.tobytes()
    assert list(one.cameras) == list(other.cameras)
    assert set(one.images) == set(other.images)
    for name, camera in one.cameras.items():
        assert_same_camera(camera, other.cameras[name])
        assert np.array_equal(one.images[name], other.images[name])  # None equals None only
    assert (one.ground_truth is None) == (other.ground_truth is None)
    if one.ground_truth is not None:
        assert_same_truth(one.ground_truth, other.ground_truth)


def assert_same_camera(one: Camera, other: Camera):
    assert (one.width_px, one.height_px) == (other.width_px, other.height_px)
    assert one.intrinsics_px.tobytes() == other.intrinsics_px.tobytes()
    assert one.camera_T_ego.tobytes() == other.camera_T_ego.tobytes()


def assert_same_truth(one: GroundTruth, other: GroundTruth):
    assert one.boxes.shape == other.boxes.shape
    assert one.boxes.tobytes() == other.boxes.tobytes()
    assert one.classes == other.classes
    assert set(one.maps) == set(other.maps)
    for name, mask in one.maps.items():
        assert mask.dtype == other.maps[name].dtype == np.bool_
        assert np.array_equal(mask, other.maps[name])


# Reading


@pytest.mark.parametrize("path", [".", "scene.json"])
def test_a_scene_folder_is_read_field_by_field(tmp_path, path):
    source = open_source(str(write_yard(tmp_path) / path))
    first, second = source
    assert len(source) == 2
    assert (first.scene, first.token, first.timestamp_s) == ("yard", "first", 10.0)
    assert (second.scene, second.token, second.timestamp_s) == ("street", "", 10.5)
    assert np.array_equal(first.images["LEFT"], LEFT_IMAGE)
    assert np.array_equal(second.images["RIGHT"], RIGHT_IMAGE)
    assert np.array_equal(first.cameras["LEFT"].intrinsics_px, INTRINSICS)
    assert np.array_equal(first.cameras["LEFT"].camera_T_ego, AHEAD)
    assert first.cameras["LEFT"].intrinsics_px.dtype == first.global_T_ego.dtype == np.float64
    assert first.ground_truth is None
    assert second.ground_truth.boxes.tolist() == [[1, 2, 3, 4, 5, 6, 0.7, 8, 9]]
    assert second.ground_truth.classes == ("car",)
    assert np.array_equal(second.ground_truth.maps["drivable_area"], MASK)


def test_a_camera_is_lost_where_its_image_is_null_or_the_frame_does_not_mention_it(tmp_path):
    first, second = SceneFolder(write_yard(tmp_path))
    assert list(first.cameras) == list(second.cameras) == ["LEFT", "RIGHT"]
    assert first.images["RIGHT"] is None
    assert second.images["LEFT"] is None


def test_a_frame_overrides_single_fields_of_a_calibration(tmp_path):
    first, second = SceneFolder(write_yard(tmp_path))
    assert (first.cameras["RIGHT"].width_px, second.cameras["RIGHT"].width_px) == (16, 8)
    assert np.array_equal(second.cameras["RIGHT"].intrinsics_px, INTRINSICS)


def test_calibration_may_stand_in_every_frame_only(tmp_path):
    frame = {**SCENE["frames"][0], "cameras": {"ROOF": {"image": "left.png", **CALIBRATION}}}
    (only,) = SceneFolder(write_yard(tmp_path, cameras={}, frames=[frame]))
    assert list(only.cameras) == ["ROOF"]
    assert np.array_equal(only.images["ROOF"], LEFT_IMAGE)


def test_known_to_be_empty_is_not_the_same_as_unknown(tmp_path):
    frames = [{**frame, "boxes": boxes} for frame, boxes in zip(SCENE["frames"], ([], None), strict=True)]
    del frames[1]["maps"]
    first, second = SceneFolder(write_yard(tmp_path, frames=frames))
    assert first.ground_truth.boxes.shape == (0, 9)
    assert first.ground_truth.has_boxes
    assert second.ground_truth is None


def test_maps_without_boxes_stay_so_when_they_are_written_again(tmp_path):
    frame = {name: value for name, value in SCENE["frames"][1].items() if name != "boxes"}
    yard = SceneFolder(write_yard(tmp_path / "yard", frames=[frame]))
    write_scene(tmp_path / "again", yard)
    for source in (yard, SceneFolder(tmp_path / "again")):
        assert list(source.frame(0).ground_truth.maps) == list(SCENE["frames"][1]["maps"])
        assert not source.frame(0).ground_truth.has_boxes
        assert source.ground_truth_boxes(0) is None


def test_a_velocity_that_is_null_is_not_known(tmp_path):
    frame = copy_of(SCENE["frames"][1])
    frame["boxes"].append({**frame["boxes"][0], "velocity_m_s": None})
    (read,) = SceneFolder(write_yard(tmp_path / "yard", frames=[frame]))
    assert np.isnan(read.ground_truth.boxes).tolist() == [[False] * 9, [False] * 7 + [True] * 2]
    write_scene(tmp_path / "again", [read])
    assert_same_frame(SceneFolder(tmp_path / "again").frame(0), read)


def test_an_absolute_path_leads_anywhere(tmp_path):
    write_png(tmp_path / "elsewhere.png", LEFT_IMAGE)
    frame = copy_of(SCENE["frames"][0])
    frame["cameras"]["LEFT"]["image"] = str(tmp_path / "elsewhere.png")
    (only,) = SceneFolder(write_yard(tmp_path / "yard", frames=[frame]))
    assert np.array_equal(only.images["LEFT"], LEFT_IMAGE)


def test_relative_paths_start_at_the_scene_wherever_the_caller_stands(tmp_path, monkeypatch):
    write_yard(tmp_path / "my yard é")
    monkeypatch.chdir(tmp_path)
    first, _ = SceneFolder("my yard é")
    assert np.array_equal(first.images["LEFT"], LEFT_IMAGE)


def test_iterating_twice_gives_the_same_frames_twice(tmp_path):
    source = SceneFolder(write_yard(tmp_path))
    for one, other in zip(source, source, strict=True):
        assert_same_frame(one, other)


def test_images_are_read_when_their_frames_turn_comes(tmp_path):
    source = SceneFolder(write_yard(tmp_path))
    frames = iter(source)
    (tmp_path / "right.png").unlink()
    assert np.array_equal(next(frames).images["LEFT"], LEFT_IMAGE)
    with pytest.raises(InputError, match=r"right\.png: expected an image file; got no such file"):
        next(frames)


@pytest.mark.skipif(not is_here(), reason="the nuScenes frames do not lie beside this checkout")
def test_real_frames_are_read_as_they_are(tmp_path):
    source = SceneFolder(write_scene_folder(tmp_path / "real"))
    for one, other in zip(source, load_frames(), strict=True):
        assert_same_frame(one, other)


# Refusing


def at(*path, value):
    """A change that puts a value where the path leads."""

    def change(scene):
        *way, last = path
        for step in way:
            scene = scene[step]
        scene[last] = value

    return change


def without(*path):
    def change(scene):
        *way, last = path
        for step in way:
            scene = scene[step]
        del scene[last]

    return change


FLAT = np.diag([1.0, 1.0, 0.0, 1.0]).tolist()
DAMAGE = {
    "no version": (without("schema_version"), "field schema_version: Field required"),
    "a newer version": (at("schema_version", value=2), "field schema_version: Input should be 1; got 2"),
    "no frames": (at("frames", value=[]), "field frames: .*at least 1 item"),
    "frames of another kind": (at("frames", value={}), "field frames: .*; got {}"),
    "an unknown field": (at("frame_rate", value=2), "field frame_rate: Extra inputs are not permitted; got 2"),
    "an unknown field of a frame": (at("frames", 1, "time", value=2), r"field frames\.1\.time: Extra inputs"),
    "no time": (without("frames", 1, "timestamp_s"), r"field frames\.1\.timestamp_s: Field required"),
    "a time that is NaN": (
        at("frames", 0, "timestamp_s", value=float("nan")),
        r"field frames\.0\.timestamp_s: Input should be a finite number; got nan",
    ),
    "an infinite pose": (
        at("frames", 0, "global_T_ego", 0, 3, value=float("-inf")),
        r"field frames\.0\.global_T_ego\.0\.3: Input should be a finite number; got -inf",
    ),
    "a pose of three rows": (without("frames", 1, "global_T_ego", 3), r"field frames\.1\.global_T_ego\.3: Field req"),
    "a pose that is flat": (at("frames", 1, "global_T_ego", value=FLAT), r"frames\.1: global_T_ego: expected a rota"),
    "no image": (without("frames", 0, "cameras", "LEFT", "image"), r"frames\.0\.cameras\.LEFT\.image: Field required"),
    "an image of another kind": (
        at("frames", 0, "cameras", "LEFT", "image", value=3),
        r"frames\.0\.cameras\.LEFT\.image: Input should be a valid string; got 3",
    ),
    "a camera nobody has calibrated": (
        at("frames", 0, "cameras", "ROOF", value={"image": None}),
        r"frames\.0\.cameras\.ROOF\.width_px: expected here, or in cameras\.ROOF; got neither",
    ),
    "a camera half calibrated": (
        at("frames", 0, "cameras", "ROOF", value={"image": None, "width_px": 16, "height_px": 8}),
        r"frames\.0\.cameras\.ROOF\.intrinsics_px: expected here, or in cameras\.ROOF; got neither",
    ),
    "a scene's camera half calibrated": (
        without("cameras", "LEFT", "camera_T_ego"),
        r"field cameras\.LEFT\.camera_T_ego: Field required",
    ),
    "a width of zero": (
        at("cameras", "LEFT", "width_px", value=0),
        r"field cameras\.LEFT\.width_px: Input should be greater than 0; got 0",
    ),
    "a negative focal length": (
        at("cameras", "LEFT", "intrinsics_px", 0, 0, value=-10.0),
        r"frames\.0: camera LEFT: intrinsics_px: .* positive focal lengths",
    ),
    "a transposed extrinsic": (
        at("cameras", "RIGHT", "camera_T_ego", value=np.transpose(AHEAD).tolist()),
        r"frames\.0: camera RIGHT: camera_T_ego: expected the last row",
    ),
    "no camera at all": (
        lambda scene: (at("cameras", value={})(scene), at("frames", 0, "cameras", value={})(scene)),
        r"field frames\.0\.cameras: expected at least one, here or in the scene's cameras; got none",
    ),
    "a box without a class": (without("frames", 1, "boxes", 0, "class"), r"frames\.1\.boxes\.0\.class: Field required"),
    "a box without a size": (
        at("frames", 1, "boxes", 0, "size_wlh_m", 1, value=0.0),
        r"frames\.1\.boxes\.0\.size_wlh_m\.1: Input should be greater than 0; got 0",
    ),
    "a time that stands still": (
        lambda scene: (without("frames", 1, "scene")(scene), at("frames", 1, "timestamp_s", value=10.0)(scene)),
        r"field frames\.1\.timestamp_s: expected later than 10\.0 of the frame before; got 10\.0",
    ),
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_wrong_scene_is_refused_by_file_and_field(tmp_path, damage):
    change, words = DAMAGE[damage]
    scene = copy_of(SCENE)
    change(scene)
    write_yard(tmp_path, **scene)
    (tmp_path / "scene.json").write_text(json.dumps(scene))
    with pytest.raises(InputError, match=words) as error:
        SceneFolder(tmp_path)
    assert str(error.value).startswith(f"{tmp_path / 'scene.json'}: field ")


def test_another_scene_may_start_earlier(tmp_path):
    frames = copy_of(SCENE["frames"])
    frames[1]["timestamp_s"] = 3.0
    assert len(list(SceneFolder(write_yard(tmp_path, frames=frames)))) == 2


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (b"", "expected JSON; got 0 characters"),
        (b'{"schema_version": 1,', "expected JSON"),
        (b"\xff\xfe{}", "cannot be read as UTF-8"),
        (b"[]", "field the top: .*; got \\[\\]"),
        (b"[" * 200_000, "expected JSON"),
    ],
)
def test_what_is_no_scene_is_refused(tmp_path, text, words):
    (tmp_path / "scene.json").write_bytes(text)
    with pytest.raises(InputError, match=rf"scene\.json: {words}"):
        SceneFolder(tmp_path)


def test_a_missing_folder_and_a_folder_without_a_scene_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"nowhere: expected a scene folder, or synthetic:SEED.* got no such path"):
        open_source(str(tmp_path / "nowhere"))
    with pytest.raises(InputError, match=r"with scene.json in it; got a folder without"):
        open_source(str(tmp_path))


def test_an_image_of_another_size_than_its_cameras_is_refused_by_its_path(tmp_path):
    source = SceneFolder(write_yard(tmp_path))
    write_png(tmp_path / "left.png", np.ascontiguousarray(LEFT_IMAGE[:, :5]))
    with pytest.raises(InputError, match=r"left\.png: expected 16x8 px, as the calibration says; got 5x8 px"):
        source.frame(0)


# Writing


def test_a_drive_that_is_written_and_read_is_the_same_drive(tmp_path, frames):
    write_scene(tmp_path / "drive", iter(frames))
    source = SceneFolder(tmp_path / "drive")
    assert len(source) == len(frames)
    for one, other in zip(source, frames, strict=True):
        assert_same_frame(one, other)


def test_lost_cameras_new_scenes_and_changed_calibrations_survive_writing(tmp_path, frames, other_frames):
    fewer = replace(
        frames[3],
        images={"CAM_BACK": frames[3].images["CAM_BACK"]},
        cameras={"CAM_BACK": frames[3].cameras["CAM_BACK"]},
        ground_truth=None,
    )
    written = [frames[0], lose(frames[1], "CAM_FRONT"), turned_rig(frames[2]), fewer, *other_frames[:2]]
    write_scene(tmp_path / "drive", written)
    for one, other in zip(SceneFolder(tmp_path / "drive"), written, strict=True):
        assert_same_frame(one, other)


def test_a_calibration_that_never_changes_is_written_once(tmp_path, frames):
    write_scene(tmp_path / "drive", [frames[0], lose(frames[1], "CAM_FRONT")])
    scene = json.loads((tmp_path / "drive" / "scene.json").read_text())
    assert set(scene["cameras"]) == set(frames[0].cameras)
    assert scene["frames"][0]["cameras"]["CAM_BACK"] == {"image": "images/CAM_BACK/000000.png"}
    assert scene["frames"][1]["cameras"]["CAM_FRONT"] == {"image": None}


def test_a_frame_that_cannot_be_right_leaves_nothing_behind(tmp_path, frames):
    bad = replace(frames[1], timestamp_s=np.nan)
    with pytest.raises(InputError, match="timestamp_s"):
        write_scene(tmp_path / "drive", [frames[0], bad])
    with pytest.raises(InputError, match="at least one frame"):
        write_scene(tmp_path / "drive", [])
    with pytest.raises(InputError, match=r"expected names that a folder can have; got '\.\./x'"):
        images, cameras = ({"../x": known["CAM_BACK"]} for known in (frames[0].images, frames[0].cameras))
        write_scene(tmp_path / "drive", [replace(frames[0], images=images, cameras=cameras)])
    with pytest.raises(InputError, match="finite places, sizes and yaws"):
        unknown = replace(frames[0].ground_truth, boxes=np.full_like(frames[0].ground_truth.boxes, np.nan))
        write_scene(tmp_path / "drive", [replace(frames[0], ground_truth=unknown)])
    for velocity in ((np.inf, np.inf), (np.nan, 1.0), (0.0, -np.inf)):
        boxes = np.array([[*frames[0].ground_truth.boxes[0, :7], *velocity]])
        halves = replace(frames[0].ground_truth, boxes=boxes, classes=frames[0].ground_truth.classes[:1])
        with pytest.raises(InputError, match="frame 0: expected velocities, or NaN twice where unknown"):
            write_scene(tmp_path / "drive", [replace(frames[0], ground_truth=halves)])
    assert list(tmp_path.iterdir()) == []


def test_a_drive_that_breaks_off_leaves_nothing_behind(tmp_path, frames):
    def broken():
        yield frames[0]
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_scene(tmp_path / "drive", broken())
    assert list(tmp_path.iterdir()) == []


def test_what_stands_at_the_place_is_kept(tmp_path, frames):
    write_yard(tmp_path / "yard")
    before = sorted(path.name for path in (tmp_path / "yard").iterdir())
    with pytest.raises(OutputError, match=r"yard: expected a new folder; it exists already"):
        write_scene(tmp_path / "yard", frames)
    assert sorted(path.name for path in (tmp_path / "yard").iterdir()) == before


def test_a_place_that_cannot_be_written_is_refused(tmp_path, frames):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="file/drive: cannot be written"):
        write_scene(tmp_path / "file" / "drive", frames[:1])
