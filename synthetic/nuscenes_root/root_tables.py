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
    """Collects rows and writes them scene by scene, because a large root has millions.

    The tables that are the same for all scenes are filled from the start.

    rows: by table, those that are not written yet.
    """

    def __init__(self, folder: Path) -> None:
        """folder: existing, of the tables. They are complete after `close`."""
        self._folder = folder
        self._started: set[str] = set()  # tables with rows in their file
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

    def flush(self) -> None:
        """Append the rows to their files, NAME.json."""
        for name, rows in self.rows.items():
            if rows:
                lines = ",\n".join(json.dumps(row, allow_nan=False) for row in rows)
                self._append(name, (",\n" if name in self._started else "[\n") + lines)
                self._started.add(name)
                rows.clear()

    def close(self) -> None:
        """Write the last rows and end the files."""
        self.flush()
        for name in TABLES:
            self._append(name, "\n]\n" if name in self._started else "[]\n")

    def _append(self, name: str, text: str) -> None:
        with (self._folder / f"{name}.json").open("a") as file:
            file.write(text)


def make_token(*parts: object) -> str:
    """A token of 32 hexadecimal digits, the same for the same parts."""
    return hashlib.blake2b("\0".join(map(str, parts)).encode(), digest_size=16).hexdigest()


def visibility_token(visible_share: float) -> str:
    """The token of the visibility level of an object."""
    return str(1 + sum(visible_share > share for share in list(VISIBILITIES.values())[:-1]))
