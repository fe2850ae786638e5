"""The JSON Schemas as validators of `jsonschema`, which knows nothing of the records they come from."""

import json
from pathlib import Path

from jsonschema import Draft202012Validator

from duospacenet.jobs.json_schemas import FILE_FORMATS, SchemaName, schema_text

EACH_FORMAT: list[tuple[SchemaName, int]] = [
    (name, version) for name, form in FILE_FORMATS.items() for version in form.versions
]
VALIDATORS = {each: Draft202012Validator(json.loads(schema_text(*each))) for each in EACH_FORMAT}


def validate(path: Path, name: SchemaName, version: int) -> None:
    """Validate a JSON file, or each line of a `.jsonl` file. Raises jsonschema's ValidationError."""
    texts = path.read_text().splitlines() if path.suffix == ".jsonl" else [path.read_text()]
    assert texts
    for text in texts:
        VALIDATORS[name, version].validate(json.loads(text))


def validate_bundle(bundle: Path) -> None:
    """Validate all JSON files of a bundle of the current schema, with its golden example."""
    golden = bundle / "golden"
    validate(bundle / "manifest.json", "manifest", 5)
    validate(golden / "expected.json", "expected", 1)
    validate(golden / "scene" / "scene.json", "scene", 1)
    validate(golden / "results.jsonl", "results", 1)
