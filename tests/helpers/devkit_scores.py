"""The metrics of a submission from nuscenes-devkit, with the names of our report."""

import math
from pathlib import Path
from typing import Any

from tests.helpers.devkit import run_devkit

ERRORS = {
    "translation": "trans_err",
    "scale": "scale_err",
    "orientation": "orient_err",
    "velocity": "vel_err",
    "attribute": "attr_err",
}


def devkit_scores(root: Path, version: str, split: str, submission: Path) -> dict[str, float | None]:
    """All metrics and numbers of boxes of `DetectionEval`, by path as in `flat_scores`."""
    got = run_devkit("detection_eval.py", root, version, split, submission)
    flat: dict[str, float | None] = {"mAP": got["mean_ap"], "NDS": got["nd_score"]}
    flat |= {f"errors.{name}": got["tp_errors"][key] for name, key in ERRORS.items()}
    for name, precisions in got["label_aps"].items():
        flat |= {f"{name}.AP.{float(distance_m):g}": value for distance_m, value in precisions.items()}
        flat |= {f"{name}.mean_AP": got["mean_dist_aps"][name]}
        flat |= {f"{name}.errors.{error}": got["label_tp_errors"][name][key] for error, key in ERRORS.items()}
        flat |= {f"{name}.truth": got["truth"].get(name, 0), f"{name}.detections": got["kept"].get(name, 0)}
    return {key: None if math.isnan(value) else value for key, value in flat.items()}


def flat_scores(report: dict[str, Any]) -> dict[str, float | None]:
    """The same numbers of our report."""
    flat: dict[str, float | None] = {name: report[name] for name in ("mAP", "NDS")}
    flat |= {f"errors.{name}": report["errors"][name] for name in ERRORS}
    for name, scores in report["classes"].items():
        flat |= {f"{name}.AP.{distance_m}": value for distance_m, value in scores["AP"].items()}
        flat |= {f"{name}.{key}": scores[key] for key in ("mean_AP", "truth", "detections")}
        flat |= {f"{name}.errors.{error}": scores["errors"][error] for error in ERRORS}
    return flat


def largest_difference(ours: dict[str, float | None], devkit: dict[str, float | None]) -> float:
    """The largest absolute difference. Both must have the same numbers, undefined ones included."""
    assert ours.keys() == devkit.keys()
    assert {key for key, value in ours.items() if value is None} == {k for k, value in devkit.items() if value is None}
    return max(abs(ours[key] - devkit[key]) for key in ours if ours[key] is not None)
