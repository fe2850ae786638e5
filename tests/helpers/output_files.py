"""The contents of output folders, and files that a user keeps in them."""

import json
from pathlib import Path

import pytest


def contents(folder: Path) -> dict[str, bytes]:
    """The bytes of every file below a folder, by its path."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def parse_strict_json(text: str) -> dict:
    """Parse JSON without NaN and infinities."""
    return json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} in JSON"))


def add_user_files(folder: Path) -> None:
    """Put files into an output folder that no command wrote."""
    (folder / "pictures").mkdir()
    (folder / "pictures" / "holiday.png").write_bytes(b"sun")
    (folder / "notes.txt").write_text("mine")


def assert_user_files_kept(folder: Path) -> None:
    assert (folder / "pictures" / "holiday.png").read_bytes() == b"sun"
    assert (folder / "notes.txt").read_text() == "mine"
