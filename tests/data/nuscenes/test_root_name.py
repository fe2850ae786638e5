import pytest

from duospacenet.data.nuscenes.root_name import parse_root_name
from duospacenet.runtime.errors import InputError


@pytest.fixture
def root(tmp_path):
    """A root with one version, in a folder whose name has a character of the syntax."""
    root = tmp_path / "me@host" / "nuScenes"
    (root / "v1.0-mini").mkdir(parents=True)
    (root / "v1.0-mini" / "sample.json").write_text("[]")
    (root / "samples").mkdir()
    return root


@pytest.mark.parametrize(
    ("suffix", "split"),
    [
        ("", None),
        ("/", None),
        ("/mini_val", "mini_val"),
        ("/mini_val/", "mini_val"),
        ("@v1.0-mini", None),
        ("@v1.0-mini/mini_val", "mini_val"),
        ("@v1.0-mini/scene-0061,scene-0103", "scene-0061,scene-0103"),
        ("/samples", "samples"),  # a folder without tables: an unknown split
    ],
)
def test_a_name_is_split_into_root_version_and_split(root, suffix, split):
    assert parse_root_name(f"{root}{suffix}") == (root, "v1.0-mini", split)


def test_a_root_may_have_an_at_sign_before_a_version(root):
    other = root.with_name("a@b")
    root.rename(other)
    assert parse_root_name(f"{other}@v1.0-mini/val") == (other, "v1.0-mini", "val")
    assert parse_root_name(f"{other}/val") == (other, "v1.0-mini", "val")
    assert parse_root_name(str(other)).folder == other / "v1.0-mini"


def test_a_name_may_be_relative(root, monkeypatch):
    monkeypatch.chdir(root)
    assert parse_root_name(".").version == "v1.0-mini"
    assert parse_root_name("./mini_val").split == "mini_val"
    assert parse_root_name(".@v1.0-mini/mini_val").split == "mini_val"
    monkeypatch.chdir(root.parent)
    assert parse_root_name("nuScenes/mini_val").split == "mini_val"


def test_one_of_several_versions_must_be_named(root):
    (root / "v1.0-trainval").mkdir()
    with pytest.raises(InputError, match=r"several \(v1\.0-mini, v1\.0-trainval\); got none\. .*nuScenes@v1\.0-mini"):
        parse_root_name(f"{root}/val")
    assert parse_root_name(f"{root}@v1.0-trainval/val").version == "v1.0-trainval"


def test_a_named_version_may_have_any_name(root):
    (root / "v1.0-mini").rename(root / "my_version")
    assert parse_root_name(f"{root}@my_version").version == "my_version"


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("", "got no folder"),
        ("{root}/nowhere/val", "got no such folder"),
        ("/nowhere", "/nowhere: expected a nuScenes root as nuscenes:ROOT.*got no such folder"),
        (
            "{root}@v1.0-min",
            r"expected a version of this nuScenes root \(v1\.0-mini\); got v1\.0-min, .* Similar: v1\.0-m",
        ),
        ("{root}@v1.0-min/val", r"got v1\.0-min, which is not a folder with tables"),
        ("{root}@samples", r"got samples, which is not a folder with tables"),
        ("{root}/samples/val", r"/samples/val: .* got no such folder, and /.*/samples has no folder v1\.0-\* of"),
        ("{root}/v1.0-mini", r"got a version folder\. Write nuscenes:/.*/nuScenes@v1\.0-mini"),
        ("{root}/v1.0-mini/mini_val", r"got a version folder\. Write nuscenes:/.*/nuScenes@v1\.0-mini/mini_val\."),
        ("{root}/../../me@host", r"/me@host: expected a nuScenes root with a folder v1\.0-\* of tables"),
        ("{root}@", r"expected a version of this nuScenes root \(v1\.0-mini\); got no name after @\.$"),
        ("/" + "x" * 300, "got no such folder"),
        ("/nul\0byte", "got no such folder"),
        ("{root}\x1b[2J/a/b", r"got no such folder"),
    ],
)
def test_a_wrong_name_is_refused_with_what_exists(root, name, message):
    with pytest.raises(InputError, match=message):
        parse_root_name(name.format(root=root))
