"""Several sources as one: which frame comes from where, and that no scene goes on in the next source."""

from dataclasses import replace
from itertools import pairwise

import pytest

from duospacenet.data.joined_source import JoinedSource, join_sources
from duospacenet.data.scene_folder import SceneFolder
from duospacenet.runtime.errors import InputError
from duospacenet.runtime.history import find_reset
from duospacenet.synthetic.drive import SyntheticDrive
from duospacenet.weights.input_contract import temporal_window
from tests.helpers.scene_folders import assert_frames_equal, write_example_scene
from tests.helpers.trainings import TINY, FixedSource, synthetic_frames


def source_of(*scenes, start_s=100.0):
    """A source with one frame per name, half a second apart."""
    (frame,) = synthetic_frames(1, 1)
    return FixedSource(
        [replace(frame, scene=name, token=f"{name}{i}", timestamp_s=start_s + i / 2) for i, name in enumerate(scenes)],
        identity="-".join(scenes),
    )


def test_a_single_source_stays_as_it_is():
    only = source_of("a")
    assert join_sources([only]) is only


def test_the_frames_follow_one_another_with_all_their_values(tmp_path):
    folder, drive = SceneFolder(write_example_scene(tmp_path)), SyntheticDrive(3, 3, (64, 32), (4, 4))
    joined = JoinedSource([folder, drive])
    assert len(joined) == 5
    for frame, expected in zip(joined, [*folder, *drive], strict=True):
        assert_frames_equal(frame, expected)
    assert list(joined.tokens) == ["first", "", *drive.tokens]
    assert [joined.has_boxes(index) for index in range(5)] == [False, True, True, True, True]
    assert [joined.has_maps(index) for index in range(5)] == [False, True, True, True, True]
    for index in range(5):
        truth = joined.frame(index).ground_truth
        assert joined.map_names(index) == (set() if truth is None else truth.maps.keys())
    assert joined.check_image_files(0) == ("RIGHT",)
    assert joined.check_image_files(2) == ()
    assert joined.ground_truth_without_maps(0) is None
    assert joined.ground_truth_without_maps(1).classes == ("car",)
    assert joined.frame_without_images(3).timestamp_s == drive.frame_without_images(1).timestamp_s


@pytest.mark.parametrize("index", [-1, 3])
def test_an_index_outside_the_frames_is_an_error(index):
    with pytest.raises(IndexError):
        JoinedSource([source_of("a", "b"), source_of("c")]).frame(index)


def test_scenes_with_the_name_of_an_earlier_source_get_the_number_of_their_source():
    joined = JoinedSource([source_of("a", "b"), source_of("b", "c"), source_of("c", "b", "d")])
    names = ["a", "b", "b (source 2)", "c", "c (source 3)", "b (source 3)", "d"]
    assert [frame.scene for frame in joined] == names
    assert [joined.frame_without_images(index).scene for index in range(7)] == names
    assert [joined.scene_name(index) for index in range(7)] == names


def test_a_new_name_is_never_one_that_exists():
    joined = JoinedSource([source_of("a"), source_of("a", "a (source 2)")])
    assert [frame.scene for frame in joined] == ["a", "a (source 2) (source 2)", "a (source 2)"]


def test_the_history_is_reset_between_sources_that_have_the_same_scene_and_any_times():
    """The second source goes on half a second later at the same place; the third begins earlier."""
    joined = JoinedSource([source_of("a"), source_of("a", start_s=100.5), source_of("a", start_s=3.0)])
    frames, limits = list(joined), temporal_window(TINY)
    reasons = [find_reset(last, now, limits) for last, now in pairwise(frames)]
    assert [reason.kind for reason in reasons] == ["new scene", "new scene"]
    alone = list(FixedSource([*source_of("a").given, *source_of("a", start_s=100.5).given]))
    assert find_reset(*alone, limits) is None


def test_the_identity_depends_on_every_source_and_their_order():
    a, b, c = source_of("a"), source_of("b"), source_of("c")
    identities = {JoinedSource(sources).identity for sources in ([a, b], [b, a], [a, c], [a, b, c])}
    assert len(identities) == 4


def test_the_class_names_of_every_source_are_checked(tmp_path):
    folder = write_example_scene(tmp_path)
    text = (folder / "scene.json").read_text()
    (folder / "scene.json").write_text(text.replace('"class": "car"', '"class": "Zeppelin"'))
    with pytest.raises(InputError, match="Zeppelin"):
        JoinedSource([source_of("a"), SceneFolder(folder)]).check_class_names(TINY.classes)
