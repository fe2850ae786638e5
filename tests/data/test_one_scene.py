"""One scene of a source as a source."""

from dataclasses import replace

import pytest

from duospacenet.data.one_scene import OneScene, ScenePiece, find_pieces
from duospacenet.data.scene_folder import SceneFolder
from duospacenet.data.scene_writer import write_scene


@pytest.fixture
def source(frames, tmp_path) -> SceneFolder:
    """Six frames of the scenes A A B A A A; the boxes of frame 4 are unknown."""
    named = [replace(frame, scene=name) for frame, name in zip(frames, "AABAAA", strict=True)]
    named[4] = replace(named[4], ground_truth=None)
    write_scene(tmp_path / "scene", named)
    return SceneFolder(tmp_path / "scene")


def test_pieces_are_consecutive_frames_of_one_scene(source):
    assert find_pieces(source) == [ScenePiece("A", 0, 2), ScenePiece("B", 2, 1), ScenePiece("A", 3, 3)]


def test_a_piece_has_the_frames_of_the_source_in_its_place(source):
    scene = OneScene(source, ScenePiece("A", 3, 3))
    assert len(scene) == 3
    assert list(scene.tokens) == list(source.tokens)[3:]
    assert [frame.token for frame in scene] == [source.frame(index).token for index in (3, 4, 5)]
    assert [scene.scene_name(index) for index in range(3)] == ["A", "A", "A"]
    assert [scene.has_boxes(index) for index in range(3)] == [True, False, True]
    assert scene.frame_without_images(2).timestamp_s == source.frame_without_images(5).timestamp_s
    assert scene.ground_truth_without_maps(0).classes == source.ground_truth_without_maps(3).classes
    assert scene.ground_truth_without_maps(1) is None
    assert scene.has_maps(0) == source.has_maps(3)
    assert [scene.map_names(index) for index in range(3)] == [source.map_names(index) for index in (3, 4, 5)]
    assert scene.check_image_files(0) == ()


@pytest.mark.parametrize("index", [-1, 3])
def test_a_piece_has_no_other_frames(source, index):
    with pytest.raises(IndexError):
        OneScene(source, ScenePiece("A", 3, 3)).frame(index)


def test_the_identity_of_the_only_scene_is_that_of_the_source(source):
    assert OneScene(source, ScenePiece("A", 0, 6)).identity == source.identity


def test_different_pieces_have_different_identities(source):
    identities = {OneScene(source, piece).identity for piece in find_pieces(source)}
    assert len(identities) == 3
    assert OneScene(source, ScenePiece("B", 2, 1)).identity == f"{source.identity}, scene 'B', frames 2 to 2"
