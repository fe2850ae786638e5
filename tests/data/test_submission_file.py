"""Submission files of other detectors: what is read, and what is refused with which words."""

import json

import numpy as np
import pytest

from duospacenet.data.nuscenes_submission import write_submission
from duospacenet.data.submission_file import SubmissionFile
from duospacenet.runtime.errors import InputError
from tests.helpers.noisy_submission import META

NAN = float("nan")
BOX = {
    "sample_token": "a",
    "translation": [1000.5, -20, 1.25],
    "size": [2.0, 4.5, 1.5],
    "rotation": [2.0, 0.0, 0.0, 2.0],
    "velocity": [NAN, 1.0],
    "detection_name": "bicycle",
    "detection_score": 0.25,
    "attribute_name": "cycle.with_rider",
}


def read(tmp_path, content) -> tuple[dict, dict | None]:
    path = tmp_path / "submission.json"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    file = SubmissionFile(path)
    return dict(iter(file)), file.meta


def one_box(**changes) -> dict:
    return {"meta": META, "results": {"a": [{**BOX, **changes}]}}


def test_all_fields_are_read(tmp_path):
    samples, meta = read(tmp_path, {"results": {"b": [], "a": [BOX]}, "other": [1], "meta": META | {"model": NAN}})
    assert (list(samples), meta, len(samples["b"])) == (["b", "a"], META, 0)
    boxes = samples["a"]
    np.testing.assert_allclose(boxes.boxes, [[1000.5, -20, 1.25, 2, 4.5, 1.5, np.pi / 2, NAN, 1]], rtol=1e-15)
    assert (boxes.scores.tolist(), boxes.classes, boxes.attributes) == ([0.25], ("bicycle",), ("cycle.with_rider",))


def test_boxes_that_say_that_they_have_no_points_are_left_out_as_in_the_devkit(tmp_path):
    samples, _ = read(tmp_path, {"meta": {}, "results": {"a": [BOX | {"num_pts": n} for n in (0, -1, 3)] + [BOX]}})
    assert len(samples["a"]) == 3


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (one_box(translation=[NAN, 0, 0]), r"sample 'a', box 0\.translation\.0: .*; got nan"),
        (one_box(translation=[1e300, 0, 0]), r"box 0\.translation\.0: .*; got 1e\+300"),
        (one_box(translation=[0, 0]), r"box 0\.translation\.2: Field required"),
        (one_box(translation=["1", 0, 0]), r"box 0\.translation\.0: .*number; got '1'"),
        (one_box(size=[1, 0, 1]), r"box 0\.size\.1: .*greater than 0; got 0"),
        (one_box(rotation=[0, 0, 0, 0]), r"box 0\.rotation: expected a quaternion with .*; got \[0, 0, 0, 0\]"),
        (one_box(rotation=[1e300, 0, 0, 0]), r"box 0\.rotation: expected a quaternion with a length .*; got \[1e\+300"),
        (one_box(rotation=[NAN, 0, 0, 1]), r"box 0\.rotation\.0: .*finite number; got nan"),
        (one_box(velocity=[float("inf"), 0]), r"box 0\.velocity\.0: expected a number, or NaN if .*; got inf"),
        (one_box(velocity=None), r"box 0\.velocity: .*; got None"),
        (one_box(detection_name="tram"), r"box 0\.detection_name: expected one of car, .*; got 'tram'"),
        (one_box(detection_score=NAN), r"box 0\.detection_score: .*; got nan"),
        (one_box(detection_score=True), r"box 0\.detection_score: .*; got True"),
        (
            one_box(attribute_name="moving"),
            r"box 0\.attribute_name: expected \"\", pedestrian\.moving, .*; got 'moving'",
        ),
        (one_box(sample_token="b"), r"sample 'a', box 0\.sample_token: expected 'a'; got 'b'"),
        ({"meta": META, "results": {"a": [{}]}}, r"sample 'a', box 0\.sample_token: Field required .*in all: 8"),
        ({"meta": META, "results": {"a": BOX}}, "sample 'a': expected a list of boxes, each an object; got {"),
        ({"meta": META, "results": {"a": [BOX] * 501}}, "sample 'a': expected at most 500 boxes, .*; got 501. Keep"),
        ({"meta": META, "results": []}, r"after the key 'results': expected a JSON object; got '\[\]"),
        ({"results": {}}, "expected the fields 'meta' and 'results'; got no 'meta'"),
        ({"meta": META}, "expected the fields 'meta' and 'results'; got no 'results'"),
        (
            '{"scene": "a", "boxes": []}\n{"scene": "a", "boxes": []}\n',  # lines of results.jsonl
            "got no 'results'.* that `run --format nuscenes` writes is results_nusc.json",
        ),
        ({"meta": [1], "results": {}}, r"field 'meta': expected an object .*; got \[1\]"),
        ({"meta": {"use_map": "no"}, "results": {}}, "field 'meta.use_map': expected true or false; got 'no'"),
        ({"meta": META, "results": {"a": None}}, "sample 'a': expected a list of boxes, .*; got None"),
        ('{"meta": {}, "meta": {}, "results": {}}', "field 'meta': expected it once; got it twice"),
        ('{"meta": {}, "results": {}, "results": {}}', "field 'results': expected it once; got it twice"),
        ('{"meta": {}, "results": {"a": [], "b": [], "a": []}}', "sample 'a': expected each sample token once"),
        (
            '{"meta": {}, "results": {"a": [{"size": 1, "size": 2}]}}',
            "'a': expected each key once .*; got 'size' twice",
        ),
        ('{"meta": {}, "results": {"a": [', "after the key 'a': expected valid JSON"),
        (
            '{"meta": {}, "results": {"\\u001b[31m": [1]}}',
            r"sample '\\x1b\[31m': expected a list of boxes, each an object; got \[1\]",
        ),
    ],
)
def test_a_file_that_the_benchmark_does_not_accept_is_refused_with_its_place(tmp_path, content, message):
    with pytest.raises(InputError, match=rf"submission\.json: .*{message}") as caught:
        read(tmp_path, content)
    assert str(caught.value).isprintable()
    assert str(caught.value).endswith(".")


def test_what_run_writes_is_read_back(tmp_path):
    box = {"class": "car", "score": 0.9, "center_m": [1, 2, 0.5], "size_wlh_m": [2, 4, 1.5], "yaw_rad": 0.1}
    box |= {"velocity_m_s": [3, 0], "attribute": "vehicle.moving"}
    result = {"token": "a", "global_T_ego": np.eye(4).tolist(), "boxes": [box]}
    write_submission(tmp_path / "written.json", [result, {**result, "token": "b", "boxes": []}])
    samples = dict(SubmissionFile(tmp_path / "written.json"))
    np.testing.assert_allclose(samples["a"].boxes, [[1, 2, 0.5, 2, 4, 1.5, 0.1, 3, 0]], atol=1e-6)
    assert len(samples["b"]) == 0
