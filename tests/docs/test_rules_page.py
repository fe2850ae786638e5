"""The table of the rules in docs/schemas.md has every rule of the manifest, with its value."""

import re
from pathlib import Path
from typing import get_args

from duospacenet.runtime.bundle.manifest import Manifest
from duospacenet.runtime.bundle.output_records import Axes, BoxLayout, DetectionSelection, MapLayout
from duospacenet.runtime.bundle.preprocessing_record import Preprocessing
from duospacenet.runtime.bundle.schema_versions import SCHEMA_VERSION
from duospacenet.runtime.bundle.temporal_window import TemporalWindow
from tests.helpers.golden_manifest import SCHEMA_5

PAGES = Path(__file__).parents[2] / "docs"
GROUPS = {
    "axes": Axes,
    "preprocessing": Preprocessing,
    "window": TemporalWindow,
    "selection": DetectionSelection,
    "boxes": BoxLayout,
    "maps": MapLayout,
}
NUMBERS = {"width_px", "height_px", "num_frames", "normalisation_in_graph"}  # of one bundle, not of the format


def rules() -> dict[str, list[str]]:
    """The values of each rule by its field, as the table writes them."""
    found = {}
    for group, record in GROUPS.items():
        for name in record.model_fields:
            value = SCHEMA_5[group][name]
            if name not in NUMBERS and not name.endswith(("_s", "time_delta_s")):
                values = value if isinstance(value, list) else [value]
                found[f"{group}.{name}"] = ["null" if each is None else str(each) for each in values]
    return found


def table() -> dict[str, list[str]]:
    """The values in the table by the fields of their row."""
    text = (PAGES / "schemas.md").read_text()
    rows = re.search(r"\| field \| value \| section \|\n.*?\n((?:\|.*\n)+)", text)
    assert rows
    cells = [row.split(" | ") for row in rows[1].splitlines()]
    return {
        name: re.findall(r"`([^`]+)`|\b(500|null|0)\b", row[1])
        for row in cells
        for name in re.findall(r"`([^`]+)`", row[0])
    }


def test_every_rule_is_in_the_table_with_its_value():
    expected, rows = rules(), {name: ["".join(value) for value in values] for name, values in table().items()}
    assert expected.keys() == rows.keys()
    for name, values in expected.items():
        assert any(rows[name][i : i + len(values)] == values for i in range(len(rows[name]))), name


def test_the_pages_name_the_newest_schema():
    text = (PAGES / "bundle-format.md").read_text()
    versions = get_args(Manifest.model_fields["schema_version"].annotation)
    assert versions[-1] == SCHEMA_VERSION
    assert f"a `schema_version` above {SCHEMA_VERSION}" in text
    assert f"schema 1 to {SCHEMA_VERSION}" in (PAGES / "schemas.md").read_text()


def test_every_field_of_the_manifest_is_on_the_page():
    text = (PAGES / "bundle-format.md").read_text()
    rows = re.findall(r"^\| (`.*?) \|", text[text.index("## Manifest") :].split("\n## ")[0], re.MULTILINE)
    assert {name for row in rows for name in re.findall(r"`(\w+)`", row)} == set(Manifest.model_fields)
