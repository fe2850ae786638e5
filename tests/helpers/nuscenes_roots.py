"""Small nuScenes roots of the synthetic world, and their tables as plain JSON."""

import json
from functools import cached_property
from pathlib import Path

import numpy as np

from duospacenet.runtime.geometry import rigid_transform, rotation_from_quaternion
from duospacenet.synthetic.nuscenes_root import write_nuscenes_root

IMAGE_SIZE = (320, 180)


def write_small_root(folder: Path, num_scenes: int = 2, num_frames: int = 4, **options) -> Path:
    """Write a root with small images to a new folder, and return the folder."""
    write_nuscenes_root(folder, num_scenes, num_frames, **{"image_size": IMAGE_SIZE, **options})
    return folder


class PlainTables:
    """The tables of a root, read with the json module alone.

    rows: by table, in file order.
    """

    def __init__(self, root: Path, version: str = "v1.0-mini") -> None:
        self.root = root
        self.rows = {path.stem: json.loads(path.read_text()) for path in sorted((root / version).glob("*.json"))}

    @cached_property
    def by_token(self) -> dict[str, dict[str, dict]]:
        """Rows by table and token."""
        return {name: {row["token"]: row for row in rows} for name, rows in self.rows.items()}

    def get(self, table: str, token: str) -> dict:
        """The row with a token."""
        return self.by_token[table][token]

    def channel(self, data: dict) -> str:
        """The sensor of a row of sample_data."""
        calibrated = self.get("calibrated_sensor", data["calibrated_sensor_token"])
        return self.get("sensor", calibrated["sensor_token"])["channel"]

    def data_of(self, sample: dict) -> dict[str, dict]:
        """The key-frame rows of sample_data of a sample, by channel."""
        rows = (row for row in self.rows["sample_data"] if row["sample_token"] == sample["token"])
        return {self.channel(row): row for row in rows if row["is_key_frame"]}

    def annotations_of(self, sample: dict) -> list[dict]:
        """The annotations of a sample, in file order."""
        return [row for row in self.rows["sample_annotation"] if row["sample_token"] == sample["token"]]

    def category(self, annotation: dict) -> str:
        """The name of the category of an annotation."""
        instance = self.get("instance", annotation["instance_token"])
        return self.get("category", instance["category_token"])["name"]

    def attributes(self, annotation: dict) -> list[str]:
        """The names of the attributes of an annotation."""
        return [self.get("attribute", token)["name"] for token in annotation["attribute_tokens"]]


def pose(row: dict) -> np.ndarray:
    """The transform (4, 4) of a row with translation and rotation."""
    return rigid_transform(rotation_from_quaternion(np.array(row["rotation"])), row["translation"])
