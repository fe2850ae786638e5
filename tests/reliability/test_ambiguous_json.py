"""Reliability row T9: ambiguous JSON in every kind of file, and text from files on the terminal.

The rules of JSON are tested in tests/runtime/test_strict_json.py; here, that every reader applies them.
"""

import json
from pathlib import Path

import pytest

from duospacenet.cli.main import run_app
from duospacenet.data.anchors_file import Anchors, read_anchors
from duospacenet.data.results import read_results
from duospacenet.data.scene_folder import SceneFolder
from duospacenet.data.scene_writer import write_scene
from duospacenet.jobs.config_file import config_to_json, read_config_file
from duospacenet.jobs.sources import open_recording
from duospacenet.model import PRESETS, DuoSpaceNet, randomise
from duospacenet.runtime.bundle.manifest import read_manifest
from duospacenet.runtime.errors import ArtifactError, DuoSpaceNetError, InputError, OutputError
from duospacenet.synthetic.drive import SyntheticDrive
from duospacenet.weights import read_config, save_checkpoint
from tests.helpers.golden_manifest import SCHEMA_2
from tests.helpers.scene_files import edit_scene
from tests.helpers.scene_folders import EXAMPLE_SCENE, write_example_scene

ANCHORS = Anchors(
    schema_version=1, source="a", num_frames=1, num_boxes=1, range_m=60.0, seed=0, centres_m=((1.0, 2.0, 3.0),)
)
RESULT = {
    "scene": "yard",
    "token": "first",
    "timestamp_s": 10.0,
    "global_T_ego": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]],
    "history": {"frames": 1, "reset_reason": None},
    "skipped": None,
    "degraded": False,
    "dropped": {"queries": 0, "map_cells": 0},
    "boxes": [],
    "maps": {},
}


def read_weights_config(path: Path):
    """Read a configuration in the metadata of a checkpoint."""
    checkpoint = path.with_suffix(".safetensors")
    save_checkpoint(checkpoint, randomise(DuoSpaceNet(PRESETS["tiny"]), 0), {"config": path.read_text()})
    return read_config(checkpoint)


def read_scene(path: Path):
    return SceneFolder(path.parent)


def read_scene_of_check_rig(path: Path):
    return open_recording(path.parent)


# By kind: the name and the text of a correct file, its reader, and the class of the error.
FILES = {
    "scene": ("scene.json", json.dumps(EXAMPLE_SCENE), read_scene, InputError),
    "scene for check-rig": ("scene.json", json.dumps(EXAMPLE_SCENE), read_scene_of_check_rig, InputError),
    "manifest": ("manifest.json", json.dumps(SCHEMA_2), lambda path: read_manifest(path.parent), ArtifactError),
    "anchors": ("anchors.json", ANCHORS.model_dump_json(), read_anchors, ArtifactError),
    "config": ("config.json", config_to_json(PRESETS["tiny"]), read_config_file, InputError),
    "weights": ("config.json", config_to_json(PRESETS["tiny"]), read_weights_config, ArtifactError),
    "results": ("results.jsonl", json.dumps(RESULT) + "\n", lambda path: list(read_results(path)), OutputError),
}


@pytest.fixture(params=FILES)
def file(request, tmp_path):
    """A correct file, its reader and the class of its errors. The reader accepts it, but a manifest lacks its seal."""
    name, text, read, error = FILES[request.param]
    if name == "scene.json":
        write_example_scene(tmp_path)
    path = tmp_path / name
    path.write_text(text)
    if name != "manifest.json":
        read(path)
    return path, read, error


def with_first_key_twice(text: str) -> str:
    """Return JSON text whose first key occurs a second time, with the same value, at the end of the object."""
    (key, value), *_ = json.loads(text).items()
    return f"{text.rstrip()[:-1]}, {json.dumps(key)}: {json.dumps(value)}}}\n"


def with_new_first_key(text: str, key_and_value: str) -> str:
    return text.replace("{", f"{{{key_and_value}, ", 1)


def test_t9_a_key_that_occurs_twice_is_refused_in_every_file(file):
    path, read, error = file
    path.write_text(with_first_key_twice(path.read_text()))
    assert_refused(path, read, error, "expected each key once in an object")


@pytest.mark.parametrize(
    ("key_and_value", "message"),
    [
        (r'"a": "\ud800"', "UTF-8 can encode"),
        (r'"\udc00": 1', "UTF-8 can encode"),
        ('"a": [1, {"b": NaN}]', "finite number"),
        ('"a": 1e400', "finite number"),
        ('"a": 99999999999999999999999', "at most 64 bits"),
        ('"a": ' + "9" * 5000, "expected JSON"),
        ('"a": ' + "[" * 100_000, "nested too deeply"),
    ],
)
def test_t9_values_that_cannot_be_stored_or_compared_are_refused_in_every_file(file, key_and_value, message):
    path, read, error = file
    path.write_text(with_new_first_key(path.read_text(), key_and_value))
    assert_refused(path, read, error, message)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-32-le"])
def test_t9_other_encodings_are_refused_in_every_file(file, encoding):
    path, read, error = file
    if read is not read_weights_config:  # metadata is a string, which has no encoding
        path.write_bytes(path.read_text().encode(encoding))
        assert_refused(path, read, error, "expected UTF-8 text")


def assert_refused(path: Path, read, error: type[DuoSpaceNetError], message: str) -> None:
    with pytest.raises(error) as refusal:
        read(path)
    # A line of results is refused as a whole, because only this toolkit writes such files.
    assert message in str(refusal.value) or "expected a frame's results" in str(refusal.value)
    assert path.stem in str(refusal.value)
    assert str(refusal.value).isprintable()


def test_t9_the_second_calibration_of_a_camera_does_not_replace_the_first(tmp_path):
    """With Python's parser, the front camera would have the calibration of the rear camera."""
    write_example_scene(tmp_path)
    text = (tmp_path / "scene.json").read_text()
    (tmp_path / "scene.json").write_text(text.replace('"RIGHT": {"width_px"', '"LEFT": {"width_px"', 1))
    with pytest.raises(InputError, match="expected each key once in an object; got 'LEFT' 2 times"):
        SceneFolder(tmp_path)


HOSTILE = "\x1b]0;title\x07\x1b[2J\x9b31m\u202e"


@pytest.mark.parametrize("place", ["scene", "camera", "token", "class", "image", "field"])
@pytest.mark.parametrize("command", ["check-rig", "eval"])
def test_t9_text_of_a_scene_never_reaches_the_terminal_raw(tiny_bundle, tmp_path, capfd, place, command):
    folder = tmp_path / "scene"
    write_scene(folder, SyntheticDrive(seed=3, frames=1))

    def edit(scene):
        frame, front = scene["frames"][0], scene["frames"][0]["cameras"]["CAM_FRONT"]
        changes = {
            "scene": lambda: scene.update(scene=HOSTILE),
            "camera": lambda: frame["cameras"].update({HOSTILE: front}),
            "token": lambda: frame.update(token=HOSTILE),
            "class": lambda: frame["boxes"][0].update({"class": HOSTILE}),
            "image": lambda: front.update(image=HOSTILE),
            "field": lambda: frame.update({HOSTILE: 1}),
        }
        changes[place]()

    edit_scene(folder, edit)
    arguments = {"check-rig": [str(folder), "--out", str(tmp_path / "out")], "eval": [str(tiny_bundle), str(folder)]}
    assert run_app([command, *arguments[command]]) == 3
    printed = capfd.readouterr()
    assert printed.out == ""
    assert printed.err.replace("\n", "").isprintable()
    assert "\\x1b" in printed.err
