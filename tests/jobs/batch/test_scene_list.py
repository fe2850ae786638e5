"""The list of a batch's scenes."""

import json
import shutil

import pytest

from duospacenet.data.one_scene import ScenePiece
from duospacenet.jobs.batch.scene_list import Scene, find_scenes
from duospacenet.runtime.errors import InputError, UsageError
from duospacenet.runtime.progress import no_progress
from tests.helpers.nuscenes_roots import write_small_root
from tests.helpers.scene_files import edit_scene


def find(*sources, check_tokens=False):
    messages = []
    scenes = find_scenes(sources, check_tokens=check_tokens, progress=no_progress, notify=messages.append)
    return scenes, messages


def test_every_scene_of_every_source_is_a_job(scene_folders, tmp_path):
    root = write_small_root(tmp_path / "root", num_scenes=2, num_frames=2)
    scenes, messages = find(scene_folders[0], f"nuscenes:{root}", "synthetic:5:3", f"trusted:{scene_folders[1]}")
    assert [(scene.scene_id, scene.piece) for scene in scenes] == [
        ("city", ScenePiece("city", 0, 4)),
        ("scene-0061", ScenePiece("scene-0061", 0, 2)),
        ("scene-0103", ScenePiece("scene-0103", 2, 2)),
        ("synthetic-5", ScenePiece("synthetic-5", 0, 3)),
        ("bridge", ScenePiece("bridge", 0, 4)),
    ]
    assert messages == []
    assert all(Scene.from_dict(json.loads(json.dumps(scene.to_dict()))) == scene for scene in scenes)


def test_a_split_chooses_scenes(tmp_path):
    root = write_small_root(tmp_path / "root", num_scenes=2, num_frames=2)
    scenes, _ = find(f"nuscenes:{root}/mini_val")
    assert [scene.scene_id for scene in scenes] == ["scene-0103"]


def test_relative_sources_become_absolute(scene_folders, monkeypatch):
    monkeypatch.chdir(scene_folders[0].parent)
    scenes, _ = find("city", "trusted:bridge", "synthetic:1:2")
    assert [scene.source for scene in scenes] == [
        str(scene_folders[0]),
        f"trusted:{scene_folders[1]}",
        "synthetic:1:2",
    ]


def test_scenes_of_one_name_in_two_sources_are_kept_apart(scene_folders, tmp_path):
    copy = shutil.copytree(scene_folders[0], tmp_path / "copy")
    scenes, _ = find(scene_folders[0], "synthetic:1:2", copy)
    assert [scene.scene_id for scene in scenes] == ["city", "synthetic-1", "city (source 3)"]
    assert len({scene.folder for scene in scenes}) == 3


def test_a_scene_in_several_pieces_is_reported_and_its_pieces_are_kept_apart(scene_folders, tmp_path):
    folder = shutil.copytree(scene_folders[0], tmp_path / "copy")
    edit_scene(folder, lambda scene: scene["frames"][1].update(scene="detour"))
    scenes, messages = find(folder)
    assert [(scene.scene_id, scene.piece.first, scene.piece.frames) for scene in scenes] == [
        ("city", 0, 1),
        ("detour", 1, 1),
        ("city (piece 2)", 2, 2),
    ]
    assert messages == [
        f"warning: {folder}: the frames of scene 'city' are in 2 separate pieces. Each piece is a scene of its own."
    ]


@pytest.mark.parametrize(
    "name", ["no_such_folder", "nuscenes:no_such_folder", "synthetic:one", "synthetic:1:0", "trusted:no_such_folder"]
)
def test_a_misspelt_source_is_refused(scene_folders, name):
    with pytest.raises(InputError, match="expected"):
        find(scene_folders[0], name)


def test_a_folder_without_scenes_is_refused(scene_folders, tmp_path):
    with pytest.raises(InputError, match="expected a scene folder"):
        find(scene_folders[0], tmp_path)


def test_a_source_that_is_given_twice_is_refused(scene_folders, tmp_path):
    link = tmp_path / "link"
    link.symlink_to(scene_folders[0])
    for other in (scene_folders[0], scene_folders[0] / "scene.json", f"trusted:{scene_folders[0]}", link):
        with pytest.raises(UsageError, match="expected each source once"):
            find(scene_folders[0], other)
    with pytest.raises(UsageError, match="expected each source once"):
        find("synthetic:1:2", "synthetic:1:2")


def test_a_scene_folder_that_cannot_be_read_is_a_scene_with_an_error(scene_folders, tmp_path):
    folder = shutil.copytree(scene_folders[0], tmp_path / "broken")
    text = (folder / "scene.json").read_text()
    (folder / "scene.json").write_text(text.replace('"timestamp_s": ', '"timestamp_s": NaN, "was": ', 1))
    scenes, _ = find(scene_folders[0], folder)
    assert [scene.scene_id for scene in scenes] == ["city", "broken"]
    assert "scene.json" in scenes[1].error
    assert scenes[0].error is None


def test_a_scene_that_is_not_plausible_is_found_by_its_worker(scene_folders, tmp_path):
    """Only its own frames are checked then, so other scenes of the file are not affected."""
    folder = shutil.copytree(scene_folders[0], tmp_path / "broken")
    edit_scene(folder, lambda scene: scene["frames"][2]["global_T_ego"][0].__setitem__(0, 7.0))
    [scene], _ = find(folder)
    assert scene.error is None


def test_a_path_out_of_the_folder_is_still_refused(scene_folders, tmp_path):
    folder = shutil.copytree(scene_folders[0], tmp_path / "broken")
    camera = {"image": "../secret.png"}
    edit_scene(folder, lambda scene: scene["frames"][2]["cameras"].update(CAM_FRONT=camera))
    [scene], _ = find(folder)
    assert "expected a path inside the scene folder" in scene.error


def test_a_submission_needs_different_tokens(scene_folders, tmp_path):
    copy = shutil.copytree(scene_folders[0], tmp_path / "copy")
    with pytest.raises(InputError, match="expected a sample token"):
        find(scene_folders[0], copy, check_tokens=True)
