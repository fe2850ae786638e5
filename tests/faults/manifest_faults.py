"""Faults in the fields of a manifest. The graphs are right."""

import copy
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from duospacenet.runtime.bundle.manifest import Manifest
from tests.helpers.bundles import edit_manifest

Random = np.random.Generator

# Fields that say how a bundle was made, and not what it computes. The parity command does not compare them.
PROVENANCE = ("schema_version", "versions", "parity", "sha256", "weights", "golden")


def manifest_fault(random: Random, manifest: Manifest, bundle: Path) -> tuple[str, Callable[[Path], Any]]:
    """Sample a fault: names in another order, or a changed value of any field."""
    names = [field for field in ("classes", "map_classes", "memory") if len(getattr(manifest, field)) > 1]
    if names and random.random() < 0.3:
        return _reordered(random, manifest, str(random.choice(names)))
    fields = list(_leaves(manifest.model_dump(mode="json")))
    groups = sorted({str(field[0]) for field in fields})
    group = str(random.choice(groups))
    chosen = [field for field in fields if field[0] == group]
    path = chosen[random.integers(len(chosen))]
    return _changed(random, path)


def set_field(*path: str | int, value: Any) -> Callable[[Path], Any]:
    """A fault that sets one field."""

    def change(manifest: dict[str, Any]) -> None:
        target: Any = manifest
        for key in path[:-1]:
            target = target[key]
        target[path[-1]] = value

    return lambda bundle: edit_manifest(bundle, change)


def _reordered(random: Random, manifest: Manifest, field: str) -> tuple[str, Callable[[Path], Any]]:
    old = list(getattr(manifest, field))
    new = old[::-1] if random.integers(2) else [*old[1:], old[0]]
    return f"{field} in another order", set_field(field, value=new)


def _changed(random: Random, path: tuple[str | int, ...]) -> tuple[str, Callable[[Path], Any]]:
    name, factor = ".".join(map(str, path)), float(random.choice([0.5, 0.9, 1.1, 2.0]))

    def change(manifest: dict[str, Any]) -> None:
        target: Any = manifest
        for key in path[:-1]:
            target = target[key]
        target[path[-1]] = _other(target[path[-1]], factor)

    return f"{name} changed", lambda bundle: edit_manifest(bundle, change)


def _other(value: Any, factor: float) -> Any:
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return value + 1 if factor > 1 else max(value - 1, 0) if value else 1
    if isinstance(value, float):
        return value * factor if value else factor
    if isinstance(value, str):
        return value + "_x" if value else "x"
    return "x" if value is None else copy.deepcopy(value)


def _leaves(value: Any, path: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """The paths of all numbers and texts of the fields that the parity command compares."""
    if isinstance(value, dict):
        for key, item in value.items():
            if path or key not in PROVENANCE:
                yield from _leaves(item, (*path, key))
    elif isinstance(value, (list, tuple)):
        for index, item in enumerate(value):
            yield from _leaves(item, (*path, index))
    elif value is not None:
        yield path
