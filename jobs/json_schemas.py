"""The JSON Schemas of the files that other programs read and write, by name."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Final, Literal, NamedTuple

from ..data.results import FrameResultSchema
from ..data.scene_schema import SCHEMA_VERSION as SCENE_VERSION
from ..data.scene_schema import SceneRecord
from ..runtime.bundle.golden_record import ExpectedValues
from ..runtime.bundle.manifest_schema import MANIFEST_VERSIONS, manifest_schema
from ..runtime.errors import UsageError
from ..runtime.files import write_atomically
from ..runtime.json_record import JsonRecord
from ..runtime.json_schema import JsonSchema, json_schema

SchemaName = Literal["manifest", "results", "scene", "expected"]


class FileFormat(NamedTuple):
    """A file format. file: what it describes. versions: oldest first. schema: returns the schema of a version."""

    file: str
    versions: tuple[int, ...]
    schema: Callable[[int], JsonSchema]


def _of_record(name: str, record_type: type[JsonRecord]) -> Callable[[int], JsonSchema]:
    return lambda version: json_schema(record_type, name, version)


FILE_FORMATS: Final[dict[SchemaName, FileFormat]] = {
    "manifest": FileFormat("manifest.json of a bundle", MANIFEST_VERSIONS, manifest_schema),
    "results": FileFormat("a line of results.jsonl", (1,), _of_record("results", FrameResultSchema)),
    "scene": FileFormat("scene.json of a scene folder", (SCENE_VERSION,), _of_record("scene", SceneRecord)),
    "expected": FileFormat("golden/expected.json of a bundle", (1,), _of_record("expected", ExpectedValues)),
}


def write_schemas(folder: str | Path) -> None:
    """Write every version of every schema to a folder, as `NAME-VERSION.schema.json`. Raises OutputError."""
    for name, form in FILE_FORMATS.items():
        for version in form.versions:
            path = Path(folder) / f"{name}-{version}.schema.json"
            write_atomically(path, schema_text(name, version).encode())


def schema_text(name: SchemaName, version: int | None = None) -> str:
    """Return the JSON Schema of a file format as text.

    version: of the format; None for the newest one. Raises UsageError for an unknown version.
    """
    versions = FILE_FORMATS[name].versions
    if version is not None and version not in versions:
        expected = str(versions[0]) if len(versions) == 1 else f"{versions[0]} to {versions[-1]}"
        raise UsageError(f"--schema-version: expected {expected} for {name}; got {version}.")
    schema = FILE_FORMATS[name].schema(versions[-1] if version is None else version)
    return json.dumps(schema, indent=2, ensure_ascii=False) + "\n"
