"""A submission of a detector that makes all kinds of errors, made from the tables of a nuScenes root."""

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from duospacenet.data.class_names import NUSCENES_CATEGORIES
from duospacenet.evaluation.protocol import CLASSES
from duospacenet.runtime.attributes import ATTRIBUTES
from tests.helpers.nuscenes_roots import PlainTables

META = {"use_camera": True, "use_lidar": False, "use_radar": False, "use_map": False, "use_external": False}
NEAR_M = 60.0  # false boxes are up to this far from the ego along x and y


def noisy_submission(tables: PlainTables, scenes: list[str], seed: int = 0) -> dict:
    """A submission for some scenes, in the order of the table of samples.

    Three of four annotations are detected, some of them twice, displaced and with noise in every number. Some are
    detected as another class. Scores have two digits, so many are equal. Some velocities are unknown. Rotations are
    slightly tilted, and are not of length 1.
    """
    rng = np.random.default_rng(seed)
    tokens = {row["token"] for row in tables.rows["scene"] if row["name"] in scenes}
    samples = [row for row in tables.rows["sample"] if row["scene_token"] in tokens]
    return {"meta": META, "results": {sample["token"]: list(_boxes(tables, sample, rng)) for sample in samples}}


def write_submission_json(path: Path, submission: dict) -> Path:
    """Write a submission as JSON; unknown velocities are NaN, as Python's json writes them."""
    path.write_text(json.dumps(submission))
    return path


def _boxes(tables: PlainTables, sample: dict, rng: np.random.Generator) -> Iterator[dict]:
    origin = tables.get("ego_pose", tables.data_of(sample)["LIDAR_TOP"]["ego_pose_token"])["translation"]
    for annotation in tables.annotations_of(sample):
        name = NUSCENES_CATEGORIES[tables.category(annotation)]
        for _ in range(rng.choice([0, 1, 2], p=[0.25, 0.6, 0.15])):
            if name is not None:
                yield _detected(tables, annotation, name, rng)
    for _ in range(rng.integers(5, 15)):
        place = origin + np.append(rng.uniform(-NEAR_M, NEAR_M, 2), rng.normal())
        yield _box(sample["token"], place, rng.uniform(0.3, 5, 3), rng.normal(size=4), rng.choice(CLASSES), rng)


def _detected(tables: PlainTables, annotation: dict, name: str, rng: np.random.Generator) -> dict:
    """A detection of an annotation, which in half of the cases has its attribute."""
    place = annotation["translation"] + rng.normal(size=3) * rng.choice([0.1, 0.5, 1.5])
    size = annotation["size"] * rng.uniform(0.7, 1.4, 3)
    rotation = (annotation["rotation"] + rng.normal(size=4) * 0.05) * rng.uniform(0.5, 2)
    box = _box(annotation["sample_token"], place, size, rotation, name if rng.random() < 0.9 else "car", rng)
    box["detection_score"] = round(float(rng.beta(3, 2)), 2)
    if rng.random() < 0.95:
        box["velocity"] = (_velocity(tables, annotation) + rng.normal(size=2) * 0.3).tolist()
    if rng.random() < 0.5:
        box["attribute_name"] = "".join(tables.attributes(annotation))
    return box


def _velocity(tables: PlainTables, annotation: dict) -> np.ndarray:
    """The velocity (2,) [m/s] to the next annotation of the same object, or from the one before."""
    first, last = annotation, annotation
    if annotation["next"]:
        last = tables.get("sample_annotation", annotation["next"])
    elif annotation["prev"]:
        first = tables.get("sample_annotation", annotation["prev"])
    times_us = [tables.get("sample", row["sample_token"])["timestamp"] for row in (first, last)]
    step_m = np.subtract(last["translation"], first["translation"])
    return step_m[:2] / max(1e-6 * (times_us[1] - times_us[0]), 1e-3)


def _box(token: str, place: np.ndarray, size: np.ndarray, rotation: np.ndarray, name: str, rng) -> dict:
    velocity = rng.normal(size=2) * 3
    return {
        "sample_token": token,
        "translation": place.tolist(),
        "size": size.tolist(),
        "rotation": rotation.tolist(),
        "velocity": [float("nan")] * 2 if rng.random() < 0.05 else velocity.tolist(),
        "detection_name": str(name),
        "detection_score": round(float(rng.beta(2, 3)), 2),
        "attribute_name": str(rng.choice(["", *ATTRIBUTES])),
    }
