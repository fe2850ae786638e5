"""JSON Schemas of the project's JSON files, generated from the records that read them.

The schemas are of draft 2020-12. They have the form that pydantic generates, in fewer words.
"""

import re
from typing import Any, Final

from .json_record import JsonRecord

DIALECT: Final = "https://json-schema.org/draft/2020-12/schema"

JsonSchema = dict[str, Any]


def json_schema(record_type: type[JsonRecord], name: str, version: int) -> JsonSchema:
    """Return the JSON Schema of a file.

    record_type: the record that reads the file.
    name, version: of the file's format, for the identity and the title of the schema.
    """
    schema = _tidy(record_type.model_json_schema())
    identity = {"$schema": DIALECT, "$id": f"urn:duospacenet:schema:{name}:{version}"}
    return identity | {"title": f"{name}, schema {version}"} | {key: schema[key] for key in schema if key != "title"}


def objects(schema: JsonSchema) -> list[JsonSchema]:
    """Return the schemas of all records: the outermost one, and those that it refers to."""
    return [schema, *schema.get("$defs", {}).values()]


def _tidy(schema: Any) -> Any:
    """Return a schema without titles that repeat the names, and with a short form of equal items."""
    if isinstance(schema, list):
        return [_tidy(part) for part in schema]
    if not isinstance(schema, dict):
        return schema
    tidied = {}
    for key, part in schema.items():
        if key == "title":
            continue
        # The keys of these are names, and "title" may be one.
        by_name = key in ("properties", "patternProperties", "$defs")
        tidied[key] = {name: _tidy(value) for name, value in part.items()} if by_name else _tidy(part)
    if isinstance(tidied.get("description"), str):
        tidied["description"] = re.sub(r"\bNone\b", "null", tidied["description"])
    if "patternProperties" in tidied:  # which would not refuse other keys
        tidied.setdefault("additionalProperties", False)
    items = tidied.get("prefixItems", [])
    if len(items) > 1 and all(item == items[0] for item in items):
        tidied["items"] = tidied.pop("prefixItems")[0]
    if tidied.get("pattern", "").endswith("$"):
        # In some languages, `$` also matches before a line end at the end of the text.
        tidied.setdefault("not", {"pattern": "\\n"})
    return tidied
