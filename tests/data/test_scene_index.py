"""The fast reader of `scene.json` accepts nothing that the strict one refuses, and reads the same records."""

import json
import pickle
import random
from pathlib import Path

import pytest

from duospacenet.data.scene_file import read_strictly
from duospacenet.data.scene_folder import SceneFolder
from duospacenet.data.scene_index import decode_frame, index_content
from duospacenet.runtime.errors import InputError
from tests.helpers.json_edits import deep_copy, set_at
from tests.helpers.json_mutations import mutate
from tests.helpers.scene_folders import (
    CALIBRATION,
    EXAMPLE_SCENE,
    LOOKING_FORWARD,
    assert_frames_equal,
    write_example_scene,
)

FULL_BOX = {**EXAMPLE_SCENE["frames"][1]["boxes"][0], "num_points": 3, "attribute": "vehicle.moving"}
FULL_SCENE = {
    **EXAMPLE_SCENE,
    "class_mapping": {"Car": "car", "Tram": None},
    "frames": [
        {**EXAMPLE_SCENE["frames"][0], "boxes": []},
        {**EXAMPLE_SCENE["frames"][1], "boxes": [FULL_BOX, {**FULL_BOX, "num_points": None, "velocity_m_s": None}]},
        {**EXAMPLE_SCENE["frames"][0], "timestamp_s": 11, "boxes": None, "scene": None},
    ],
}


def strict_records(content):
    """What the strict reader makes of a file. Raises InputError."""
    return list(read_strictly(Path("scene.json"), content)[1])


def fast_records(content):
    """What the fast reader makes of it; None if it leaves the file to the strict one."""
    index = index_content(content)
    if index is None:
        return None
    places = zip(index.starts, index.sizes, strict=True)
    return [decode_frame(content[start : start + size]) for start, size in places]


def test_valid_files_are_read_fast():
    for scene in (EXAMPLE_SCENE, FULL_SCENE):
        for options in ({}, {"indent": 2}, {"ensure_ascii": False}, {"separators": (",", ":")}):
            content = json.dumps(scene, **options).encode()
            assert fast_records(content) == strict_records(content)


@pytest.mark.parametrize("text", ["drive: 1", "a::b", 'say "x": y', "Straße 東京", "back\\slash", "😀", "a/b"])
def test_unusual_texts_are_read_fast(text):
    scene = deep_copy(FULL_SCENE)
    scene["scene"] = scene["frames"][0]["token"] = scene["frames"][0]["cameras"]["LEFT"]["image"] = text
    scene["frames"][1]["boxes"][0]["class"] = scene["frames"][1]["maps"][text] = text
    scene["cameras"][text] = CALIBRATION
    for ensure_ascii in (True, False):
        content = json.dumps(scene, ensure_ascii=ensure_ascii).encode()
        assert fast_records(content) == strict_records(content)


def test_an_escaped_colon_is_left_to_the_strict_reader(tmp_path):
    content = json.dumps({**EXAMPLE_SCENE, "scene": "colon"}).replace("colon", r"a\u003ab")
    assert index_content(content.encode()) is None
    folder = write_example_scene(tmp_path)
    (folder / "scene.json").write_text(content)
    assert SceneFolder(folder).frame(0).scene == "a:b"


TEXT = json.dumps(FULL_SCENE)
REPEATED = [
    ('"scene": "yard"', '"scene": "yard", "scene": "yard"'),
    ('"schema_version": 1', '"schema_version": 1, "schema_version": 1'),
    ('"Tram": null', '"Tram": null, "Tram": null'),
    ('"frames": [', '"frames": [], "frames": ['),
    ('"LEFT": {"width_px"', '"LEFT": {}, "LEFT": {"width_px"'),
    ('"width_px": 16, "height_px"', '"width_px": 16, "width_px": 16, "height_px"'),
    ('"token": "first"', '"token": "first", "token": "first"'),
    ('"LEFT": {"image"', '"LEFT": {"image": null}, "LEFT": {"image"'),
    ('"image": "right.png"', '"image": "right.png", "image": null'),
    ('"yaw_rad": 0.7', '"yaw_rad": 0.7, "yaw_rad": 0.7'),
    ('"num_points": 3', '"num_points": 3, "num_points": 4'),
    ('"drivable_area": "mask.png"', '"drivable_area": "mask.png", "drivable_area": "other.png"'),
    ('"boxes": []', '"boxes": [], "boxes": []'),
]


@pytest.mark.parametrize(("before", "after"), REPEATED)
def test_a_key_that_occurs_twice_is_never_read_fast(before, after):
    assert before in TEXT
    content = TEXT.replace(before, after, 1).encode()
    assert index_content(content) is None
    with pytest.raises(InputError, match="expected each key once"):
        strict_records(content)


def test_what_is_read_fast_is_what_the_strict_reader_accepts():
    rng = random.Random(0)
    fast = refused = 0
    for _ in range(3000):
        content = json.dumps(mutate(rng, deep_copy(FULL_SCENE))).encode("utf-8", "surrogatepass")
        if rng.random() < 0.1:  # damage in the text itself
            position = rng.randrange(len(content))
            content = content[:position] + bytes([rng.randrange(256)]) + content[position + 1 :]
        records = fast_records(content)
        if records is None:
            try:
                strict_records(content)
            except InputError:
                refused += 1
        else:
            fast += 1
            assert records == strict_records(content)
    assert fast > 300
    assert refused > 1000


def test_numbers_are_read_to_the_last_bit():
    rng = random.Random(1)
    poses = [
        [[rng.uniform(-1, 1) * 10 ** rng.randrange(-9, 9) for _ in range(4)] for _ in range(4)] for _ in range(200)
    ]
    frames = [{**EXAMPLE_SCENE["frames"][0], "global_T_ego": pose, "timestamp_s": i} for i, pose in enumerate(poses)]
    records = fast_records(json.dumps({**EXAMPLE_SCENE, "frames": frames}).encode())
    assert [[list(line) for line in record.global_T_ego] for record in records] == poses


# --- Checks of numbers --------------------------------------------------------------------------------------------

SCALED = [[value * 1.01 for value in line] for line in LOOKING_FORWARD[:3]] + [[0, 0, 0, 1]]
IN_MESSAGE = {"width_px": "intrinsics_px"}  # the focal length does not fit the width
IMPOSSIBLE = {
    "a scaled rotation": ("camera_T_ego", SCALED),
    "a mirrored rotation": ("camera_T_ego", [[0, 1, 0, 0], *LOOKING_FORWARD[1:]]),
    "a last row": ("camera_T_ego", [*LOOKING_FORWARD[:3], [0, 0, 1, 1]]),
    "a far camera": ("camera_T_ego", [[0, -1, 0, 2e9], *LOOKING_FORWARD[1:]]),
    "a transposed matrix": ("intrinsics_px", [[10, 0, 0], [0, 10, 0], [8, 4, 1]]),
    "a focal length of zero": ("intrinsics_px", [[0, 0, 8], [0, 10, 4], [0, 0, 1]]),
    "a long focal length": ("intrinsics_px", [[10, 0, 8], [0, 500, 4], [0, 0, 1]]),
    "a principal point outside": ("intrinsics_px", [[10, 0, 50], [0, 10, 4], [0, 0, 1]]),
    "a last element": ("intrinsics_px", [[10, 0, 8], [0, 10, 4], [0, 0, 2]]),
    "a skew beyond limits": ("intrinsics_px", [[10, 2e9, 8], [0, 10, 4], [0, 0, 1]]),
    "a size": ("width_px", 2000),
}


@pytest.mark.parametrize("case", IMPOSSIBLE)
@pytest.mark.parametrize("place", [("cameras", "LEFT"), ("frames", 1101, "cameras", "LEFT")])
def test_an_impossible_calibration_is_found_among_many_frames(tmp_path, case, place):
    field, value = IMPOSSIBLE[case]
    frame = EXAMPLE_SCENE["frames"][0]
    scene = deep_copy({**EXAMPLE_SCENE, "frames": [{**frame, "timestamp_s": number} for number in range(1200)]})
    set_at(*place, field, value=value)(scene)
    (tmp_path / "scene.json").write_text(json.dumps(scene))
    number = 1101 if place[0] == "frames" else 0
    with pytest.raises(
        InputError, match=rf"scene\.json: field frames\.{number}: camera LEFT: {IN_MESSAGE.get(field, field)}"
    ):
        SceneFolder(tmp_path)
    assert SceneFolder(tmp_path, checked=False).frame_without_images(1101).timestamp_s == 1101


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (set_at("frames", 1101, "timestamp_s", value=1e12), r"frames\.1101: timestamp_s: expected seconds"),
        (set_at("frames", 1101, "timestamp_s", value=1100), r"frames\.1101\.timestamp_s: expected later than 1100"),
        (set_at("frames", 1101, "global_T_ego", value=SCALED), r"frames\.1101: global_T_ego: expected a rotation"),
        (
            set_at("frames", 1101, "cameras", "NEW", value={"image": None, "width_px": 3}),
            r"frames\.1101\.cameras\.NEW\.height_px: expected a value",
        ),
        (
            set_at("frames", 1101, "cameras", "LEFT", "image", value="../x.png"),
            r"frames\.1101\.cameras\.LEFT\.image: expected a path inside",
        ),
        (set_at("frames", 1101, "maps", value={"m": "/x.png"}), r"frames\.1101\.maps\.m: expected a path inside"),
    ],
)
def test_a_wrong_frame_is_found_among_many(tmp_path, change, message):
    frame = EXAMPLE_SCENE["frames"][0]
    scene = deep_copy({**EXAMPLE_SCENE, "frames": [{**frame, "timestamp_s": number} for number in range(1200)]})
    change(scene)
    (tmp_path / "scene.json").write_text(json.dumps(scene))
    with pytest.raises(InputError, match=message):
        SceneFolder(tmp_path)


# --- Frames are read from the file --------------------------------------------------------------------------------


def test_a_pickled_scene_is_small_and_gives_the_same_frames(tmp_path):
    frame = deep_copy(EXAMPLE_SCENE["frames"][0])
    frames = [{**frame, "timestamp_s": number, "token": f"token {number}"} for number in range(2000)]
    source = SceneFolder(write_example_scene(tmp_path, frames=frames))
    pickled = pickle.dumps(source)
    assert len(pickled) < 40 * len(source)
    again = pickle.loads(pickled)
    assert list(again.tokens) == list(source.tokens) == [f"token {number}" for number in range(2000)]
    for index in (0, 1999, 7):
        assert_frames_equal(again.frame(index), source.frame(index))


@pytest.mark.parametrize("change", ["removed", "rewritten", "truncated"])
def test_a_file_that_changes_while_it_is_used_is_refused(tmp_path, change):
    source = SceneFolder(write_example_scene(tmp_path))
    path = tmp_path / "scene.json"
    if change == "removed":
        path.unlink()
    elif change == "rewritten":
        path.write_text(path.read_text().replace("10.5", "10.7"))
    else:
        path.write_bytes(path.read_bytes()[:50])
    with pytest.raises(InputError, match=r"scene\.json: expected the file that was checked at the start"):
        source.frame_without_images(1)


def test_the_records_of_an_unusual_file_are_pickled_too(tmp_path):
    folder = write_example_scene(tmp_path)
    text = (folder / "scene.json").read_text().replace("yard", r"\u003a")
    (folder / "scene.json").write_text(text)
    source = SceneFolder(folder)
    again = pickle.loads(pickle.dumps(source))
    assert list(again.tokens) == list(source.tokens) == ["first", ""]
    for one, other in zip(again, source, strict=True):
        assert_frames_equal(one, other)


@pytest.mark.parametrize("number", [1e300, -1e19 - 1e5, 2**63, 1.5e18])
def test_large_numbers_are_read_and_left_to_the_checks_of_the_rig(tmp_path, number):
    scene = deep_copy(EXAMPLE_SCENE)
    scene["frames"][1]["boxes"][0]["center_m"][0] = scene["frames"][1]["timestamp_s"] = number
    scene["cameras"]["LEFT"]["width_px"] = 2**63
    (tmp_path / "scene.json").write_text(json.dumps(scene))
    source = SceneFolder(tmp_path, checked=False)
    assert source.frame_without_images(1).timestamp_s == number
    assert source.frame_without_images(1).cameras["LEFT"].width_px == 2**63
    assert source.ground_truth_without_maps(1).boxes[0, 0] == number
    with pytest.raises(InputError, match=r"scene\.json: field frames\.0: camera LEFT"):
        SceneFolder(tmp_path)


def test_the_strict_reader_keeps_every_field():
    content = json.dumps(FULL_SCENE).encode()
    header, frames = read_strictly(Path("scene.json"), content)
    assert list(frames) == fast_records(content)
    assert header == index_content(content).header
