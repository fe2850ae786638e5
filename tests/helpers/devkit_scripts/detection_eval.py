"""Evaluates a submission with the devkit, and prints its metrics.

Usage: detection_eval.py ROOT VERSION SPLIT SUBMISSION. SPLIT is a split of the devkit, or one of the root's own
`VERSION/splits.json`. NaN and infinity are printed as Python's `json` does.
"""

# pyright: reportMissingImports=false

import contextlib
import json
import sys
import tempfile

import matplotlib

matplotlib.use("Agg")

from nuscenes.eval.common.config import config_factory  # noqa: E402
from nuscenes.eval.detection.evaluate import DetectionEval  # noqa: E402
from nuscenes.nuscenes import NuScenes  # noqa: E402


def main(root: str, version: str, split: str, submission: str) -> None:
    with contextlib.redirect_stdout(sys.stderr), tempfile.TemporaryDirectory() as folder:
        tables = NuScenes(version, root, verbose=False)
        evaluation = DetectionEval(tables, config_factory("detection_cvpr_2019"), submission, split, folder, False)
        metrics, _ = evaluation.evaluate()
    print(
        json.dumps({**metrics.serialize(), "truth": count(evaluation.gt_boxes), "kept": count(evaluation.pred_boxes)})
    )


def count(boxes) -> dict[str, int]:
    """The number of boxes by class, after the filters."""
    names = [box.detection_name for box in boxes.all]
    return {name: names.count(name) for name in sorted(set(names))}


if __name__ == "__main__":
    main(*sys.argv[1:])
