"""Writes the results of a run as a nuScenes submission file, the input of the nuScenes detection benchmark."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from ..runtime.errors import InputError
from ..runtime.files import atomic_path
from ..runtime.geometry import quaternion_from_rotation, rotation_z, transform
from .results import FrameResult

META = {"use_camera": True, "use_lidar": False, "use_radar": False, "use_map": False, "use_external": False}

MOVING_M_S = 0.2  # a faster object counts as moving


def write_submission(path: Path, results: Iterable[FrameResult]) -> None:
    """Write a submission file, completely or not at all.

    Boxes are converted to the global frame and get an attribute. A skipped frame has an empty list of boxes, because
    nuScenes requires every sample. Results have at most 500 boxes, which is the limit of nuScenes.

    Raises OutputError if the file cannot be written.
    """
    # Each sample is written on its own, because the results of a whole data set may not fit in memory.
    with atomic_path(path) as temporary, temporary.open("w", encoding="utf-8") as file:
        file.write(f'{{"meta": {json.dumps(META)}, "results": {{')
        for number, result in enumerate(results):
            boxes = [_submission_box(result, box) for box in result["boxes"]]
            comma = ", " if number else ""
            file.write(f"{comma}{json.dumps(result['token'])}: {json.dumps(boxes, allow_nan=False)}")
        file.write("}}")


def check_sample_tokens(tokens: Iterable[str]) -> None:
    """Check that every frame has a unique token, the key of its sample in a submission. Raises InputError."""
    seen: set[str] = set()
    for number, token in enumerate(tokens):
        if not token or token in seen:
            got = f"{token!r} for the second time" if token else "no token"
            raise InputError(
                f"frame {number}: expected a sample token for the nuScenes format; got {got}. "
                "Give every frame of the source its own token."
            )
        seen.add(token)


def likely_attribute(name: str, speed_m_s: float) -> str:
    """Return the most likely nuScenes attribute of an object, by its class and speed; empty for classes without one."""
    moves = speed_m_s > MOVING_M_S
    if name in ("barrier", "traffic_cone"):
        return ""
    if name == "pedestrian":
        return "pedestrian.moving" if moves else "pedestrian.standing"
    if name in ("motorcycle", "bicycle"):
        return "cycle.with_rider" if moves else "cycle.without_rider"
    if name == "bus" and not moves:
        return "vehicle.stopped"
    return "vehicle.moving" if moves else "vehicle.parked"


def _submission_box(result: FrameResult, box: dict[str, Any]) -> dict[str, Any]:
    """Convert a box of a result, in the ego frame, to a box of the submission, in the global frame."""
    global_T_ego = np.array(result["global_T_ego"])
    global_R_ego = global_T_ego[:3, :3]
    velocity = global_R_ego @ [*box["velocity_m_s"], 0.0]
    return {
        "sample_token": result["token"],
        "translation": transform(global_T_ego, np.array(box["center_m"])).tolist(),
        "size": box["size_wlh_m"],
        "rotation": list(map(float, quaternion_from_rotation(global_R_ego @ rotation_z(box["yaw_rad"])))),
        "velocity": velocity[:2].tolist(),
        "detection_name": box["class"],
        "detection_score": box["score"],
        "attribute_name": likely_attribute(box["class"], float(np.hypot(*box["velocity_m_s"]))),
    }
