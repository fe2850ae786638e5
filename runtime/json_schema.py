"""JSON Schemas of the project's JSON files, generated from the records that read them.

The schemas are of draft 2020-12. They have the form that pydantic generates, in fewer words.
"""

import re
from typing import Any, Final

from .json_record import JsonRecord

DIALECT: Final = "https://json-schema.org/draft/2020-12/schema"

JsonSchema = dict[str, Any]

_BY_NAME = ("properties", "patternProperties", "$defs")


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
    """Return a schema without titles that repeat the names, and with its objects in their short form."""
    if isinstance(schema, list):
        return [_tidy(part) for part in schema]
    if not isinstance(schema, dict):
        return schema
    tidied: dict[str, Any] = {}
    for key, part in schema.items():
        if key in _BY_NAME:  # the keys of the part are names, and "title" may be one
            tidied[key] = {name: _tidy(value) for name, value in part.items()}
        elif key != "title":
            tidied[key] = _tidy(part)
    return _short_form(tidied)


def _short_form(schema: JsonSchema) -> JsonSchema:
    """Return an equivalent of a schema whose parts are tidied. It means the same in all validators."""
    if isinstance(schema.get("description"), str):
        schema["description"] = re.sub(r"\bNone\b", "null", schema["description"])
    for pattern, value in schema.pop("patternProperties", {}).items():  # at most one, and it does not refuse other keys
        schema["propertyNames"] = _short_form(schema.get("propertyNames", {}) | {"pattern": pattern})
        schema["additionalProperties"] = value
    items = schema.get("prefixItems", [])
    if len(items) > 1 and all(item == items[0] for item in items):
        schema["items"] = schema.pop("prefixItems")[0]
    if schema.get("pattern", "").endswith("$"):
        # In some languages, `$` also matches before a line end at the end of the text.
        schema.setdefault("not", {"pattern": "\\n"})
    return schema
