"""Which version a root has, and how its scenes are named."""

import pytest

from duospacenet.runtime.errors import UsageError
from duospacenet.synthetic.nuscenes_root.scene_names import choose_version


def test_up_to_ten_scenes_are_those_of_mini_in_ascending_order():
    version = choose_version(10)
    assert version.name == "v1.0-mini"
    assert version.scenes[:3] == ("scene-0061", "scene-0103", "scene-0553")
    assert version.scenes[-1] == "scene-1100"


def test_more_scenes_are_those_of_trainval():
    version = choose_version(11)
    assert version.name == "v1.0-trainval"
    assert version.scenes == tuple(f"scene-{number:04d}" for number in range(1, 12))  # 3 is of val, the others of train


@pytest.mark.parametrize(
    ("split", "version", "first"),
    [
        ("mini_train", "v1.0-mini", "scene-0061"),
        ("mini_val", "v1.0-mini", "scene-0103"),
        ("train", "v1.0-trainval", "scene-0001"),
        ("val", "v1.0-trainval", "scene-0003"),
        ("test", "v1.0-test", "scene-0077"),
    ],
)
def test_a_split_decides_version_and_names(split, version, first):
    chosen = choose_version(2, split)
    assert (chosen.name, chosen.scenes[0], chosen.has_annotations) == (version, first, split != "test")


@pytest.mark.parametrize(
    ("num_scenes", "split", "message"),
    [(851, None, "at most 850, the scenes of train and val; got 851"), (1, "mini\x1b", r"mini\\x1b")],
)
def test_too_many_scenes_and_unknown_splits_are_refused(num_scenes, split, message):
    with pytest.raises(UsageError, match=message):
        choose_version(num_scenes, split)
