"""Small nuScenes roots, written row by row, for cases that a synthetic world does not have."""

import json
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from duospacenet.data.class_names import NUSCENES_CATEGORIES
from duospacenet.runtime.attributes import ATTRIBUTES

VERSION = "v1.0-mini"
SCENE = "scene-0103"  # of the split mini_val
SPLIT = "mini_val"
STEP_S = 0.5
PITCHED_AND_ROLLED = (0.8, 0.02, -0.05, 0.6)  # quaternion, w first; its length is 1.0015


@dataclass
class HandmadeRoot:
    """One scene of key frames 0.5 s apart. Its vehicle is at (100, 200, 1) m, pitched and rolled, and moves along x.

    num_samples: number of key frames.
    """

    num_samples: int = 3
    step_s: float = STEP_S
    rotation: tuple[float, ...] = PITCHED_AND_ROLLED
    annotations: list[dict[str, Any]] = field(default_factory=list)
    instances: list[dict[str, Any]] = field(default_factory=list)

    def ego_translation(self, sample: int) -> np.ndarray:
        """Where the vehicle is (3,) [m]."""
        return np.array([100.0 + 3 * sample, 200, 1])

    def token(self, sample: int) -> str:
        """The token of a key frame."""
        return f"sample {sample}"

    def add(
        self,
        category: str,
        offset_m: tuple[float, ...],
        *,
        sample: int = 0,
        attribute: str = "",
        points: int = 5,
        **row,
    ) -> dict[str, Any]:
        """Annotate an object in one key frame. offset_m: from the vehicle, in the axes of the global frame.

        row: other fields of the annotation. Returns the row.
        """
        number = len(self.annotations)
        instance = {"token": f"instance {number}", "category_token": category}
        self.instances.append(instance)
        annotation = {
            "token": f"annotation {number}",
            "sample_token": self.token(sample),
            "instance_token": instance["token"],
            "visibility_token": "4",
            "attribute_tokens": [attribute] if attribute else [],
            "translation": (self.ego_translation(sample) + offset_m).tolist(),
            "size": [2.0, 4.0, 1.5],
            "rotation": [1.0, 0.0, 0.0, 0.0],
            "prev": "",
            "next": "",
            "num_lidar_pts": points,
            "num_radar_pts": 0,
        }
        self.annotations.append(annotation | row)
        return self.annotations[-1]

    def add_track(self, category: str, offsets_m: list[tuple[float, ...]], **row) -> list[dict[str, Any]]:
        """Annotate an object in consecutive key frames, from the first one on."""
        track = [self.add(category, offset, sample=sample, **row) for sample, offset in enumerate(offsets_m)]
        for before, after in pairwise(track):
            before["next"], after["prev"] = after["token"], before["token"]
            after["instance_token"] = before["instance_token"]
        return track

    def write(self, folder: Path) -> Path:
        """Write the root. Its split mini_val has all key frames."""
        tables = self._tables()
        (folder / VERSION).mkdir(parents=True)
        for name, rows in tables.items():
            (folder / VERSION / f"{name}.json").write_text(json.dumps(rows))
        cv2.imwrite(str(folder / "map.png"), np.zeros((8, 8), np.uint8))
        return folder

    def _tables(self) -> dict[str, list[dict[str, Any]]]:
        samples = range(self.num_samples)
        times_us = [1_500_000_000_000_000 + round(1e6 * self.step_s * sample) for sample in samples]
        used = {annotation["instance_token"] for annotation in self.annotations}
        neighbours = [{"prev": "" if s == 0 else self.token(s - 1), "next": self.token(s + 1)} for s in samples]
        neighbours[-1]["next"] = ""
        rows = zip(samples, times_us, neighbours, strict=True)
        return {
            "category": [{"token": name, "name": name, "description": ""} for name in NUSCENES_CATEGORIES],
            "attribute": [{"token": name, "name": name, "description": ""} for name in ATTRIBUTES],
            "visibility": [{"token": "4", "level": "v80-100", "description": ""}],
            "log": [{"token": "log", "logfile": "", "vehicle": "", "date_captured": "", "location": "boston-seaport"}],
            "map": [{"token": "map", "log_tokens": ["log"], "category": "semantic_prior", "filename": "map.png"}],
            "scene": [{"token": "scene", "name": SCENE, "log_token": "log", "description": "", "nbr_samples": 1}],
            "sensor": [
                {"token": "LIDAR_TOP", "channel": "LIDAR_TOP", "modality": "lidar"},
                {"token": "CAM_FRONT", "channel": "CAM_FRONT", "modality": "camera"},
            ],
            "calibrated_sensor": [_calibration("LIDAR_TOP", []), _calibration("CAM_FRONT", _INTRINSICS)],
            "sample": [{"token": self.token(s), "timestamp": t, "scene_token": "scene", **n} for s, t, n in rows],
            "sample_data": [
                self._sample_data(sample, channel, times_us[sample])
                for sample in samples
                for channel in ("LIDAR_TOP", "CAM_FRONT")
            ],
            "ego_pose": [
                {
                    "token": f"pose {sample}",
                    "timestamp": times_us[sample],
                    "translation": self.ego_translation(sample).tolist(),
                    "rotation": list(self.rotation),
                }
                for sample in samples
            ],
            "instance": [instance for instance in self.instances if instance["token"] in used],
            "sample_annotation": self.annotations,
        }

    def _sample_data(self, sample: int, channel: str, time_us: int) -> dict[str, Any]:
        return {
            "token": f"{channel} {sample}",
            "sample_token": self.token(sample),
            "ego_pose_token": f"pose {sample}",
            "calibrated_sensor_token": channel,
            "timestamp": time_us,
            "fileformat": "jpg",
            "is_key_frame": True,
            "height": 900,
            "width": 1600,
            "filename": f"samples/{channel}/{sample}",
            "prev": "",
            "next": "",
        }


_INTRINSICS = [[1266.0, 0.0, 816.0], [0.0, 1266.0, 491.0], [0.0, 0.0, 1.0]]


def _calibration(sensor: str, intrinsics: list[list[float]]) -> dict[str, Any]:
    rotation = [0.5, -0.5, 0.5, -0.5] if intrinsics else [1.0, 0.0, 0.0, 0.0]
    pose = {"translation": [1.7, 0.0, 1.5], "rotation": rotation}
    return {"token": sensor, "sensor_token": sensor, **pose, "camera_intrinsic": intrinsics}
