"""The metrics of a submission from nuscenes-devkit, with the names of our report."""

import math
from pathlib import Path
from typing import Any, NamedTuple

from tests.helpers.devkit import run_devkit

Scores = dict[str, float | None]
ERRORS = {
    "translation": "trans_err",
    "scale": "scale_err",
    "orientation": "orient_err",
    "velocity": "vel_err",
    "attribute": "attr_err",
}


class DevkitCase(NamedTuple):
    """A submission for a split of a root."""

    root: Path
    version: str
    split: str
    submission: Path


def devkit_scores(*cases: DevkitCase) -> list[Scores]:
    """All metrics and numbers of boxes of `DetectionEval` for each case, by path as in `flat_scores`."""
    return [_flat(got) for got in run_devkit("detection_eval.py", *(value for case in cases for value in case))]


def _flat(got: dict[str, Any]) -> Scores:
    flat: Scores = {"mAP": got["mean_ap"], "NDS": got["nd_score"]}
    flat |= {f"errors.{name}": got["tp_errors"][key] for name, key in ERRORS.items()}
    for name, precisions in got["label_aps"].items():
        flat |= {f"{name}.AP.{float(distance_m):g}": value for distance_m, value in precisions.items()}
        flat |= {f"{name}.mean_AP": got["mean_dist_aps"][name]}
        flat |= {f"{name}.errors.{error}": got["label_tp_errors"][name][key] for error, key in ERRORS.items()}
        flat |= {f"{name}.truth": got["truth"].get(name, 0), f"{name}.detections": got["kept"].get(name, 0)}
    return {key: None if value is None or math.isnan(value) else value for key, value in flat.items()}


def flat_scores(report: dict[str, Any]) -> Scores:
    """The same numbers of our report."""
    flat: Scores = {name: report[name] for name in ("mAP", "NDS")}
    flat |= {f"errors.{name}": report["errors"][name] for name in ERRORS}
    for name, scores in report["classes"].items():
        flat |= {f"{name}.AP.{distance_m}": value for distance_m, value in scores["AP"].items()}
        flat |= {f"{name}.{key}": scores[key] for key in ("mean_AP", "truth", "detections")}
        flat |= {f"{name}.errors.{error}": scores["errors"][error] for error in ERRORS}
    return flat


def largest_difference(ours: Scores, devkit: Scores) -> float:
    """The largest absolute difference. Both must have the same numbers, undefined ones included."""
    assert ours.keys() == devkit.keys()
    assert {key for key, value in ours.items() if value is None} == {k for k, value in devkit.items() if value is None}
    return max(abs(ours[key] - devkit[key]) for key in ours if ours[key] is not None)
