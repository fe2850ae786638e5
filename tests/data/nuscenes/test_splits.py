import pytest

from duospacenet.data.nuscenes.splits import SCENE_NUMBERS, choose_scenes, published_split
from duospacenet.runtime.errors import InputError
from tests.helpers.devkit import run_devkit

SCENES = ["scene-0916", "scene-0103", "scene-0061", "scene-1100"]


def test_the_published_splits_have_the_published_sizes_and_share_no_scene():
    sizes = {name: len(set(published_split(name))) for name in SCENE_NUMBERS}
    assert sizes == {"train": 700, "val": 150, "test": 150, "mini_train": 8, "mini_val": 2}
    names = [published_split(name) for name in ("train", "val", "test")]
    assert len(set().union(*names)) == 1000
    assert published_split("mini_val") == ("scene-0103", "scene-0916")


@pytest.mark.slow
def test_the_published_splits_are_those_of_the_devkit():
    expected = run_devkit("published_splits.py")
    assert {name: list(published_split(name)) for name in SCENE_NUMBERS} == {
        name: sorted(scenes) for name, scenes in expected.items()
    }


@pytest.mark.parametrize(
    ("split", "expected"),
    [
        (None, ("scene-0061", "scene-0103", "scene-0916", "scene-1100")),
        ("mini_val", ("scene-0103", "scene-0916")),
        ("mini_train", ("scene-0061", "scene-1100")),
        ("scene-1100,scene-0061", ("scene-1100", "scene-0061")),
        ("scene-1100, scene-0061", ("scene-1100", "scene-0061")),
    ],
)
def test_the_scenes_of_a_split_are_chosen(tmp_path, split, expected):
    assert choose_scenes(split, SCENES, tmp_path) == expected


def test_a_root_may_have_splits_of_its_own(tmp_path):
    (tmp_path / "splits.json").write_text(
        '{"night": ["scene-1100", "scene-0103", "scene-5000"], "val": ["scene-0061"]}'
    )
    assert choose_scenes("night", SCENES, tmp_path) == ("scene-0103", "scene-1100")
    assert choose_scenes("val", SCENES, tmp_path) == ("scene-0061",)
    assert choose_scenes("mini_val", SCENES, tmp_path) == ("scene-0103", "scene-0916")
    with pytest.raises(
        InputError, match=r"expected a split \(night, val, train, test, mini_train.*got 'nigth'\. Simil"
    ):
        choose_scenes("nigth", SCENES, tmp_path)
    (tmp_path / "splits.json").write_text('{"night": []}')
    with pytest.raises(InputError, match="split night; got a version that has none of its 0 scenes"):
        choose_scenes("night", SCENES, tmp_path)
    (tmp_path / "splits.json").write_text('["night"]')
    with pytest.raises(InputError, match=r"splits\.json: expected lists of scene names by split"):
        choose_scenes("night", SCENES, tmp_path)


@pytest.mark.parametrize(
    ("split", "message"),
    [
        ("mini-val", r"got 'mini-val'\. Similar names: mini_val"),
        (
            "scene-0104",
            r"names of its scenes \(scene-0061, scene-0103, scene-0916, scene-1100\); got 'scene-0104'\. Sim",
        ),
        ("scene-0103,scene-0103", "expected each scene once; got scene-0103 several times"),
        ("MINI_VAL", r"got 'MINI_VAL'\. Similar names: mini_val\.$"),
        ("Scene-0103", r"got 'Scene-0103'\. Similar names: scene-0103\.$"),
        ("scene-0103,mini_val", "got the split mini_val together with other names"),
        ("scene-0103,,", "got ''"),
        (
            "test",
            r"split test; got a version that has none of its 150 scenes\. Splits .*: train, val, mini_train, mini_v",
        ),
        ("\x1b[2J", r"got '\\x1b\[2J'"),
    ],
)
def test_an_unknown_split_or_scene_is_refused_with_similar_names(tmp_path, split, message):
    with pytest.raises(InputError, match=message):
        choose_scenes(split, SCENES, tmp_path)
