"""Messages for configurations that pydantic refuses: the wrong field, the allowed values and the value found."""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from pydantic import ValidationError

Location = tuple[int | str, ...]  # as pydantic reports it: ("backbone", "ResNetConfig", "depths", 3)


def describe_error(error: ValidationError, tables: Mapping[str, type]) -> str:
    """Describe the first wrong field of a configuration, and count the others.

    tables: the dataclass of each table in the file, by the last part of pydantic's location; "" is the top level.
        For a field with several possible dataclasses, pydantic's location contains the class name. Files do not.
    """
    first, *others = error.errors()
    more = f" (wrong fields in all: {len(others) + 1})" if others else ""
    field = _field_name(first["loc"], tables)
    match first["type"]:
        case "unexpected_keyword_argument":
            text = f"{field} is unknown; expected only {_field_names(first['loc'][:-1], tables)}"
        case "missing":
            text = f"{field} is missing"
        case "dataclass_type":
            text = f"{field}: expected a table of {_field_names(first['loc'], tables)}; got {_shorten(first['input'])}"
        case "value_error":  # from a __post_init__; its message starts with the field's name in its table
            table = f"{field}." if first["loc"] else ""
            text = table + first["msg"].removeprefix("Value error, ").rstrip(".")
        case _:
            text = f"{field}: {first['msg']}; got {_shorten(first['input'])}"
    return text + more


def _field_name(location: Location, tables: Mapping[str, type]) -> str:
    """The field's name in a file, such as `backbone.depths.3`."""
    classes = {table.__name__ for table in tables.values()}
    return ".".join(str(part) for part in location if part not in classes) or "the top level"


def _field_names(location: Location, tables: Mapping[str, type]) -> str:
    """The names of all fields of the table at a location."""
    table = tables[str(location[-1]) if location else ""]
    return ", ".join(field.name for field in fields(table))


def _shorten(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
