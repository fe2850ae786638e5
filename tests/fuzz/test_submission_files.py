"""Damaged submission files are refused as input data, or their scores are finite."""

import json

import numpy as np
from hypothesis import strategies as st

from duospacenet.data.submission_file import SubmissionFile
from duospacenet.evaluation import Sample, evaluate
from duospacenet.runtime.errors import InputError
from tests.fuzz.damage import damaged_bytes, damaged_json, to_text
from tests.fuzz.test_fuzz import fuzz, is_accepted
from tests.helpers.evaluation_samples import box, make_ground_truth

BOX = {
    "sample_token": "a",
    "translation": [10.0, 0.0, 0.0],
    "size": [2.0, 4.0, 1.5],
    "rotation": [1.0, 0.0, 0.0, 0.1],
    "velocity": [0.5, 1.0],
    "detection_name": "car",
    "detection_score": 0.25,
    "attribute_name": "vehicle.moving",
}
SUBMISSION = {"meta": {"use_camera": True, "use_map": False}, "results": {"a": [dict(BOX), dict(BOX)], "b": []}}


def test_a_damaged_submission_is_refused_or_has_finite_scores(tmp_path):
    path, truth = tmp_path / "submission.json", make_ground_truth([box(10)], ["car"])

    def read():
        file = SubmissionFile(path)
        with np.errstate(over="raise", divide="raise", invalid="raise"):
            report = evaluate(Sample.in_global_frame(boxes, truth, np.eye(4)) for _, boxes in file)
        json.dumps([report.to_dict(), file.meta], allow_nan=False)

    def check(text):
        path.write_bytes(text)
        return is_accepted(read, InputError)

    fuzz(st.one_of(damaged_json(SUBMISSION).map(to_text), damaged_bytes(to_text(SUBMISSION))), check)
