"""Names of the scenes' folders."""

import hashlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from duospacenet.jobs.batch.folder_names import folder_names


def digest(text: str) -> str:
    return hashlib.sha256(text.encode(errors="surrogatepass")).hexdigest()[:12]


def test_plain_ids_are_their_own_names():
    ids = ["scene-0061", "n015-2018-07-24", "drive_3.part", "_x"]
    assert folder_names(ids) == ids


@pytest.mark.parametrize(
    ("scene_id", "readable"),
    [
        ("../../etc/passwd", "_.._etc_passwd"),
        ("..", "scene"),
        (".", "scene"),
        ("", "scene"),
        (".hidden", "hidden"),
        ("-rf", "rf"),
        ("a/b", "a_b"),
        ("a\x00b", "a_b"),
        ("\x1b[31mred", "_31mred"),
        ("two words", "two_words"),
        ("scene-0061 (source 2)", "scene-0061_source_2_"),
        ("東京", "_"),
        ("\ud800", "_"),
        ("x" * 5000, "x" * 80),
    ],
)
def test_a_hostile_id_gets_a_plain_name_with_a_hash(scene_id, readable):
    assert folder_names([scene_id]) == [f"{readable}-{digest(scene_id)}"]


def test_ids_that_differ_only_in_case_both_get_a_hash():
    assert folder_names(["City", "city", "park"]) == [f"City-{digest('City')}", f"city-{digest('city')}", "park"]


def test_an_id_that_looks_like_the_name_of_another_one_gets_a_hash_too():
    imitation = f"a_b-{digest('a/b')}"
    assert folder_names(["a/b", imitation]) == [imitation, f"{imitation}-{digest(imitation)}"]


@given(st.lists(st.text(max_size=100) | st.text("aA./- ", max_size=3), unique=True, max_size=8))
def test_names_are_safe_and_differ_on_every_file_system(scene_ids):
    names = folder_names(scene_ids)
    assert len({name.lower() for name in names}) == len(scene_ids)
    for name in names:
        assert name.isascii() and 0 < len(name) <= 120
        assert name[0] not in ".-" and "/" not in name and name.isprintable() and " " not in name
