"""The 13 tables of a nuScenes root, as rows of JSON."""

import hashlib
import json
from pathlib import Path
from typing import Any

from ...data.class_names import NUSCENES_CATEGORIES
from .object_attributes import ATTRIBUTES

Row = dict[str, Any]

TABLES = (
    "attribute",
    "calibrated_sensor",
    "category",
    "ego_pose",
    "instance",
    "log",
    "map",
    "sample",
    "sample_annotation",
    "sample_data",
    "scene",
    "sensor",
    "visibility",
)
VISIBILITIES = {"v0-40": 0.4, "v40-60": 0.6, "v60-80": 0.8, "v80-100": 1.0}  # level: largest visible share


class RootTables:
    """Rows by table. The tables that are the same for all scenes are filled from the start."""

    def __init__(self) -> None:
        self.rows: dict[str, list[Row]] = {name: [] for name in TABLES}
        for name in NUSCENES_CATEGORIES:
            description = f"Annotated as {name} in nuScenes."
            self.add("category", token=make_token("category", name), name=name, description=description)
        for name, description in ATTRIBUTES.items():
            self.add("attribute", token=make_token("attribute", name), name=name, description=description)
        for token, (level, share) in enumerate(VISIBILITIES.items(), start=1):
            description = f"At most {share:.0%} of the object is visible in the six cameras."
            self.add("visibility", token=str(token), level=level, description=description)

    def add(self, table: str, **fields: Any) -> Row:
        """Add a row and return it."""
        self.rows[table].append(fields)
        return fields

    def write(self, folder: Path) -> None:
        """Write each table as NAME.json to a folder."""
        for name, rows in self.rows.items():
            with (folder / f"{name}.json").open("w") as file:
                file.write("[\n" + ",\n".join(json.dumps(row, allow_nan=False) for row in rows) + "\n]\n")


def make_token(*parts: object) -> str:
    """A token of 32 hexadecimal digits, the same for the same parts."""
    return hashlib.blake2b("\0".join(map(str, parts)).encode(), digest_size=16).hexdigest()


def visibility_token(visible_share: float) -> str:
    """The token of the visibility level of an object."""
    return str(1 + sum(visible_share > share for share in list(VISIBILITIES.values())[:-1]))
