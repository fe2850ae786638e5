"""The table of docs/recipes.md with the values in which the two built-in recipes differ, from the files."""

import re
from dataclasses import fields

from duospacenet.training import Settings
from duospacenet.training.recipe import FOLDER

HEADER = "| setting | `cpu` | `paper` | source of the paper's value |\n| --- | --- | --- | --- |\n"


def recipe_table() -> str:
    cpu, paper = _lines("cpu"), _lines("paper")
    absent = ("–", "")
    rows = []
    for field in fields(Settings):
        (ours, _), (value, source) = cpu.get(field.name, absent), paper.get(field.name, absent)
        if ours != value:
            rows.append(f"| `{field.name}` | {ours} | {value} | {source} |\n")
    return HEADER + "".join(rows)


def _lines(name: str) -> dict[str, tuple[str, str]]:
    """The value and the comment of each setting of a recipe, as texts."""
    matches = re.findall(r"^(\w+) = (.*?)(?: +# (.*))?$", (FOLDER / f"{name}.toml").read_text(), re.MULTILINE)
    return {setting: (value, comment) for setting, value, comment in matches}
