# ruff: noqa: T201
"""Prints what `check-rig` says about each mistake of the catalogue: `python -m tests.rig.mistake_table [RIG:SEED ...]`.

right: the right cause, and no other. mixed: another cause beside it, or instead of it. missed: the verdict is ok.
"""

import json
import re
import shutil
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from duospacenet.jobs.sources import open_recording
from duospacenet.rig import RigRequirements, examine
from duospacenet.rig.rig_report import rig_report_dict
from tests.rig.mistake_scenes import copy_with_mistake, write_base
from tests.rig.mistakes import MISTAKES
from tests.rig.scene_mistake import Mistake


def main(rigs: list[str]) -> None:
    """Print a row per mistake, and a column per rig and seed."""
    totals: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        bases = {rig: write_base(Path(folder) / rig, rig.split(":")[0], int(rig.split(":")[1])) for rig in rigs}
        for rig, base in bases.items():
            print(f"{'no mistake':36}{rig:14}{report_of(base)['verdict']}")
        for name, mistake in MISTAKES.items():
            for rig, base in bases.items():
                outcome, texts = try_mistake(mistake, base, Path(folder) / "copy", int(rig.split(":")[1]))
                totals[outcome] += 1
                print(f"{name:36}{rig:14}{outcome:8}{'' if outcome == 'right' else texts[:400]}", flush=True)
    print(dict(totals))


def try_mistake(mistake: Mistake, base: Path, folder: Path, seed: int) -> tuple[str, str]:
    """Make a mistake in a copy of a scene folder. Returns the outcome and the findings as text."""
    record = json.loads((base / "scene.json").read_text())
    cameras = mistake.inject(record, np.random.default_rng([seed, len(mistake.cause)]))
    shutil.rmtree(folder, ignore_errors=True)
    report = report_of(copy_with_mistake(base, folder, record), 8 if mistake.compares_images else 1)
    return judge(report, mistake, cameras)


def report_of(folder: Path, num_frames: int = 8) -> dict[str, Any]:
    """The content of rig.json."""
    examination = examine(open_recording(str(folder)), RigRequirements(), num_frames)
    return rig_report_dict("", examination, dict.fromkeys(examination.views, ""))


def judge(report: dict[str, Any], mistake: Mistake, cameras: list[str]) -> tuple[str, str]:
    """The outcome and the findings as text."""
    findings = {
        "drive": report["drive"]["findings"],
        "ground_truth": report.get("ground_truth", {}).get("findings", []),
        "cameras": [finding for camera in report["cameras"].values() for finding in camera["findings"]],
    }
    text = "; ".join(f"{part}: {each['subject']}: {each['cause']}" for part in findings for each in findings[part])
    if report["verdict"] == "ok":
        return "missed", text
    is_right = [re.search(mistake.cause, each["cause"]) is not None for each in findings[mistake.part]]
    others = [part for part in findings if part != mistake.part and findings[part]]
    others += [name for name, camera in report["cameras"].items() if camera["findings"] and name not in cameras]
    if mistake.part == "cameras" and is_right:
        is_right += [
            any(re.search(mistake.cause, finding["cause"]) for finding in report["cameras"][name]["findings"])
            for name in cameras
        ]
    has_alternatives = any("; or " in each["cause"] for each in findings[mistake.part])
    return ("right" if is_right and all(is_right) and not others and not has_alternatives else "mixed"), text


if __name__ == "__main__":
    main(sys.argv[1:] or ["nuscenes:3", "numbered:4", "five:5", "seven:6"])
