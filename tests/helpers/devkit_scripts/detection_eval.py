"""Evaluates a submission with the devkit, and prints its metrics and the number of boxes after its filters as JSON.

Usage: detection_eval.py ROOT VERSION SPLIT SUBMISSION. SPLIT is a split of the devkit, or one of the root's own
`VERSION/splits.json`.
"""

# pyright: reportMissingImports=false

import contextlib
import json
import sys
import tempfile

from nuscenes.eval.common.config import config_factory
from nuscenes.eval.detection.evaluate import DetectionEval
from nuscenes.nuscenes import NuScenes


def main(root: str, version: str, split: str, submission: str) -> None:
    with contextlib.redirect_stdout(sys.stderr), tempfile.TemporaryDirectory() as folder:
        tables = NuScenes(version, root, verbose=False)
        evaluation = DetectionEval(tables, config_factory("detection_cvpr_2019"), submission, split, folder, False)
        metrics, _ = evaluation.evaluate()
    counts = {"truth": count(evaluation.gt_boxes), "kept": count(evaluation.pred_boxes)}
    json.dump({**metrics.serialize(), **counts}, sys.stdout)


def count(boxes) -> dict[str, int]:
    """The number of boxes by class."""
    names = [box.detection_name for box in boxes.all]
    return {name: names.count(name) for name in sorted(set(names))}


if __name__ == "__main__":
    main(*sys.argv[1:])
