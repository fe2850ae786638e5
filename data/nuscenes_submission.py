"""The nuScenes submission file, the input of its detection benchmark, made from the results of a run."""

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

MOVING_M_S = 0.2  # an object slower than this counts as standing


def write_submission(path: Path, results: Iterable[FrameResult]) -> None:
    """Write the submission file of the results of a run. The file is written completely or not at all.

    Boxes are converted to the global frame and get an attribute. A skipped sample has an empty list of boxes, since
    nuScenes wants every sample. Results have at most 500 boxes, the limit of nuScenes.
    Raises OutputError if it cannot be written.
    """
    # Written sample by sample, so that the results of a whole data set need not fit in memory.
    with atomic_path(path) as temporary, temporary.open("w", encoding="utf-8") as file:
        file.write(f'{{"meta": {json.dumps(META)}, "results": {{')
        for number, result in enumerate(results):
            boxes = [_submission_box(result, box) for box in result["boxes"]]
            comma = ", " if number else ""
            file.write(f"{comma}{json.dumps(result['token'])}: {json.dumps(boxes, allow_nan=False)}")
        file.write("}}")


def check_sample_tokens(tokens: Iterable[str]) -> None:
    """Check that every frame has its own token, which is the key of its sample in a submission. Raises InputError."""
    seen: set[str] = set()
    for number, token in enumerate(tokens):
        if not token or token in seen:
            got = f"{token!r} for the second time" if token else "no token"
            raise InputError(
                f"frame {number}: expected a sample token for the nuScenes format; got {got}. "
                "Give every frame of the source its own."
            )
        seen.add(token)


def likely_attribute(name: str, speed_m_s: float) -> str:
    """Return the most likely nuScenes attribute of an object of class `name`, by its speed. Empty if it has none."""
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
    """Return a box of a result, in the ego frame, as an entry of the submission, in the global frame."""
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
