"""Changes to nested JSON values, for tests of files with one wrong field."""

import json
from collections.abc import Callable
from typing import Any

Change = Callable[[Any], None]


def set_at(*path: str | int, value: Any) -> Change:
    """Return a change that stores `value` at the nested key `path`."""

    def change(root: Any) -> None:
        _parent(root, path)[path[-1]] = value

    return change


def delete_at(*path: str | int) -> Change:
    """Return a change that deletes the nested key `path`."""

    def change(root: Any) -> None:
        del _parent(root, path)[path[-1]]

    return change


def deep_copy(value: Any) -> Any:
    """Copy a JSON value so that no two parts of the copy are the same object."""
    return json.loads(json.dumps(value))


def _parent(root: Any, path: tuple[str | int, ...]) -> Any:
    for key in path[:-1]:
        root = root[key]
    return root
