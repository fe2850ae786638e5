"""The nuScenes submission: what its detection evaluation reads, made from the results of a run."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from ..runtime.errors import InputError
from ..runtime.files import atomic_path
from ..runtime.geometry import quaternion_from_rotation, rotation_z, transform
from .results import FrameResult

USES = {"use_camera": True, "use_lidar": False, "use_radar": False, "use_map": False, "use_external": False}

MOVING_M_S = 0.2  # slower than this, an object is taken to stand


def write_submission(path: Path, records: Iterable[FrameResult]) -> None:
    """Write the submission, whole or not at all, a record at a time: global frame, at most 500 boxes a sample,
    attributes; a sample that was skipped has no boxes. Raises OutputError.
    """
    with atomic_path(path) as temporary, temporary.open("w", encoding="utf-8") as file:
        file.write(f'{{"meta": {json.dumps(USES)}, "results": {{')
        for number, record in enumerate(records):
            boxes = [_submitted(record, box) for box in record["boxes"]]
            comma = ", " if number else ""
            file.write(f"{comma}{json.dumps(record['token'])}: {json.dumps(boxes, allow_nan=False)}")
        file.write("}}")


def check_sample_tokens(tokens: Iterable[str]) -> None:
    """Raises InputError unless every frame has a token of its own: a submission knows its samples by it."""
    seen: set[str] = set()
    for number, token in enumerate(tokens):
        if not token or token in seen:
            got = f"{token!r} for the second time" if token else "none"
            raise InputError(
                f"frame {number}: expected a sample token for the nuScenes format; got {got}. "
                "Give every frame of the source its own."
            )
        seen.add(token)


def likely_attribute(name: str, speed_m_s: float) -> str:
    """The likeliest nuScenes attribute of an object of class `name`."""
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


def _submitted(record: FrameResult, box: dict[str, Any]) -> dict[str, Any]:
    global_T_ego = np.array(record["global_T_ego"])
    global_R_ego = global_T_ego[:3, :3]
    velocity = global_R_ego @ [*box["velocity_m_s"], 0.0]
    return {
        "sample_token": record["token"],
        "translation": transform(global_T_ego, np.array(box["center_m"])).tolist(),
        "size": box["size_wlh_m"],
        "rotation": list(map(float, quaternion_from_rotation(global_R_ego @ rotation_z(box["yaw_rad"])))),
        "velocity": velocity[:2].tolist(),
        "detection_name": box["class"],
        "detection_score": box["score"],
        "attribute_name": likely_attribute(box["class"], float(np.hypot(*box["velocity_m_s"]))),
    }
