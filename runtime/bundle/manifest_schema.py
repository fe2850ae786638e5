"""The JSON Schema of `manifest.json`, for each schema version of the manifest."""

from typing import Any, Final, get_args

from ..json_schema import JsonSchema, json_schema, objects
from .manifest import GRAPH_DEPENDENCIES, GRAPH_NAMES, REQUIRED_GRAPHS, Manifest, graph_file_name
from .schema_versions import FIRST_COMPLETE_VERSION, SCHEMA_VERSION, SINCE_KEY

MANIFEST_VERSIONS: Final[tuple[int, ...]] = get_args(Manifest.model_fields["schema_version"].annotation)


def manifest_schema(version: int = SCHEMA_VERSION) -> JsonSchema:
    """Return the JSON Schema of the manifests of one schema version, which is one of `MANIFEST_VERSIONS`."""
    schema = json_schema(Manifest, "manifest", version)
    for record in objects(schema):
        _keep_fields_of_version(record, version)
    fields = schema["properties"]
    fields["schema_version"] = {"const": version}
    fields["graphs"] |= _graphs()
    if version < FIRST_COMPLETE_VERSION:
        fields["config"] = {"type": "object"}
    if version > 1:
        fields["sha256"] = {"type": "string", "pattern": "^[0-9a-f]{64}$", "not": {"pattern": "\\n"}}
        schema["required"] = sorted({*schema["required"], "sha256"}, key=list(fields).index)
    schema |= _precision_and_quantization()
    schema["$defs"] = _used_definitions(schema)
    return schema


def _keep_fields_of_version(record: JsonSchema, version: int) -> None:
    """Remove the later fields from the schema of a record.

    Since schema 5, require all fields, without defaults. Deprecated fields are optional.
    """
    fields = record.get("properties", {})
    for name in [name for name, field in fields.items() if field.pop(SINCE_KEY, 1) > version]:
        del fields[name]
    if version >= FIRST_COMPLETE_VERSION and fields:
        record["required"] = [name for name, field in fields.items() if not field.get("deprecated")]
        for field in fields.values():
            field.pop("default", None)


def _graphs() -> JsonSchema:
    """The names and files of the graphs, and which graphs need others."""
    return {
        "properties": {
            name: {
                "$ref": "#/$defs/GraphSpec",
                "type": "object",  # the strict mode of some validators needs it beside "properties"
                "properties": {"file": {"const": graph_file_name(name)}},
            }
            for name in GRAPH_NAMES
        },
        "additionalProperties": False,
        "required": list(REQUIRED_GRAPHS),
        "dependentRequired": {name: list(needed) for name, needed in GRAPH_DEPENDENCIES.items()},
    }


def _precision_and_quantization() -> JsonSchema:
    """Exactly the bundles of precision int8 have a quantization record."""
    return {
        "if": {"properties": {"precision": {"const": "int8"}}, "required": ["precision"]},
        "then": {"properties": {"quantization": {"type": "object"}}, "required": ["quantization"]},
        "else": {"properties": {"quantization": {"type": "null"}}},
    }


def _used_definitions(schema: JsonSchema) -> JsonSchema:
    """Return the definitions that a schema refers to, directly or by others."""
    definitions, used = schema["$defs"], set[str]()
    new = _references({key: part for key, part in schema.items() if key != "$defs"})
    while new:
        used |= new
        new = {name for user in new for name in _references(definitions[user])} - used
    return {name: definitions[name] for name in definitions if name in used}


def _references(schema: Any) -> set[str]:
    if isinstance(schema, dict):
        found = {schema["$ref"].rpartition("/")[2]} if isinstance(schema.get("$ref"), str) else set()
        return found.union(*map(_references, schema.values()))
    return set().union(*map(_references, schema)) if isinstance(schema, list) else set()
