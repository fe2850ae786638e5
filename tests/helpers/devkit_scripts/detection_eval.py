"""Evaluates submissions with the devkit, and prints their metrics and numbers of boxes after its filters as JSON.

Usage: detection_eval.py ROOT VERSION SPLIT SUBMISSION [ROOT VERSION SPLIT SUBMISSION ...]. SPLIT is a split of the
devkit, or one of the root's own `VERSION/splits.json`. The output is a list with an object for each submission.
"""

import contextlib
import json
import sys
import tempfile

from nuscenes.eval.common.config import config_factory
from nuscenes.eval.detection.evaluate import DetectionEval
from nuscenes.nuscenes import NuScenes


def main(*arguments: str) -> None:
    with contextlib.redirect_stdout(sys.stderr):
        results = [evaluate(*arguments[start : start + 4]) for start in range(0, len(arguments), 4)]
    json.dump(results, sys.stdout)


def evaluate(root: str, version: str, split: str, submission: str) -> dict:
    """The metrics, and the number of boxes by class, of the ground truth and of the detections."""
    tables = NuScenes(version, root, verbose=False)
    with tempfile.TemporaryDirectory() as folder:
        evaluation = DetectionEval(tables, config_factory("detection_cvpr_2019"), submission, split, folder, False)
        metrics, _ = evaluation.evaluate()
    return {**metrics.serialize(), "truth": count(evaluation.gt_boxes), "kept": count(evaluation.pred_boxes)}


def count(boxes) -> dict[str, int]:
    """The number of boxes by class."""
    names = [box.detection_name for box in boxes.all]
    return {name: names.count(name) for name in sorted(set(names))}


if __name__ == "__main__":
    main(*sys.argv[1:])
