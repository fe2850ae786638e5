import json

import pytest

from duospacenet.data.anchors_file import Anchors, check_new_file, read_anchors, write_anchors
from duospacenet.runtime.errors import ArtifactError, OutputError

ANCHORS = Anchors(
    schema_version=1,
    centres_m=((1.0, 2.0, 3.0), (4.5, -5.0, 0.0)),
    source="synthetic:1:2",
    num_frames=2,
    num_boxes=9,
    range_m=55.0,
    seed=3,
)


def test_written_anchors_are_read_back_unchanged(tmp_path):
    write_anchors(tmp_path / "new" / "anchors.json", ANCHORS)
    assert read_anchors(tmp_path / "new" / "anchors.json") == ANCHORS
    assert ANCHORS.centres.tolist() == [[1.0, 2.0, 3.0], [4.5, -5.0, 0.0]]


def test_an_existing_file_is_refused_and_not_changed(tmp_path):
    (tmp_path / "anchors.json").write_text("mine")
    with pytest.raises(OutputError, match="it exists already"):
        write_anchors(tmp_path / "anchors.json", ANCHORS)
    assert (tmp_path / "anchors.json").read_text() == "mine"


def test_a_broken_symbolic_link_is_refused_and_not_changed(tmp_path):
    (tmp_path / "anchors.json").symlink_to("nowhere")
    with pytest.raises(OutputError, match="it exists already"):
        write_anchors(tmp_path / "anchors.json", ANCHORS)
    assert (tmp_path / "anchors.json").readlink().name == "nowhere"


def test_checking_for_a_new_file_leaves_nothing_on_disk(tmp_path):
    check_new_file(tmp_path / "new" / "newer" / "anchors.json")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"schema_version": 2}, "field schema_version: .*; got 2"),
        ({"centres_m": []}, "field centres_m: "),
        ({"centres_m": [[1.0, 2.0]]}, r"field centres_m\.0\.2: Field required"),
        ({"centres_m": [[1.0, 2.0, "3"]]}, r"field centres_m\.0\.2: .*; got '3'"),
        ({"num_boxes": 0}, "field num_boxes"),
        ({"centres_m": [[0, 0, 0], [33.0, -44.1, 0]]}, r"field centres_m: .*range_m, 55 m, .*index 1 is 55\.08 m away"),
        ({"centres_m": [[0, 0, 1e300]]}, r"field centres_m: .*index 0 is 1e\+300 m away"),
        ({"range_m": 1e300, "centres_m": [[0, 0, 1e300]]}, r"field range_m: .*less than or equal to 1000; got 1e\+300"),
        ({"boxes": 9}, "field boxes: .*not permitted"),
    ],
)
def test_a_wrong_field_is_reported_with_the_file_and_its_name(tmp_path, change, message):
    path = tmp_path / "anchors.json"
    path.write_text(json.dumps(ANCHORS.model_dump(mode="json") | change))
    with pytest.raises(ArtifactError, match=rf"anchors\.json: {message}"):
        read_anchors(path)


def test_an_anchor_may_be_exactly_at_the_range(tmp_path):
    path = tmp_path / "anchors.json"
    path.write_text(json.dumps(ANCHORS.model_dump(mode="json") | {"centres_m": [[33.0, -44.0, 0.0]]}))
    assert read_anchors(path).centres.tolist() == [[33.0, -44.0, 0.0]]


@pytest.mark.parametrize("value", ["NaN", "Infinity", "1e999"])
def test_numbers_that_are_not_finite_are_refused(tmp_path, value):
    path = tmp_path / "anchors.json"
    path.write_text(ANCHORS.model_dump_json().replace("4.5", value))
    with pytest.raises(ArtifactError, match=r"field centres_m\.1\.0: "):
        read_anchors(path)


def test_a_missing_file_and_a_binary_file_are_refused_with_their_path(tmp_path):
    with pytest.raises(ArtifactError, match=r"none\.json: expected a file; got no such file"):
        read_anchors(tmp_path / "none.json")
    (tmp_path / "binary.json").write_bytes(b"\x93NUMPY")
    with pytest.raises(ArtifactError, match=r"binary\.json: expected UTF-8 text; got bytes that are not"):
        read_anchors(tmp_path / "binary.json")
