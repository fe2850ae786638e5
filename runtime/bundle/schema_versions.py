"""Schema versions of the manifest: which fields a manifest of a version must have, and which it cannot have.

Schema 5 has every field. Older schemas lack the later ones, and the defaults of the records say what was meant then.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from pydantic import GetJsonSchemaHandler
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

from ..errors import ArtifactError
from ..json_record import JsonRecord
from ..strict_json import dotted

SCHEMA_VERSION: Final = 5
FIRST_COMPLETE_VERSION: Final = 5  # every field is present from here on
SINCE_KEY: Final = "since"


@dataclass(frozen=True)
class Since:
    """An annotation of a field: the schema version that introduced it. Fields without it exist since schema 1."""

    version: int

    def __get_pydantic_json_schema__(self, core_schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Pass the version on to the code that writes JSON Schemas."""
        return {**handler(core_schema), SINCE_KEY: self.version}


@dataclass(frozen=True)
class DescribedBy:
    """An annotation of a field that is read as JSON values: the record that describes it since schema 5."""

    record_type: type[JsonRecord]

    def __get_pydantic_json_schema__(self, core_schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Describe the record instead of the JSON values."""
        return handler(self.record_type.__pydantic_core_schema__)


def check_fields_of_version(path: Path, record: JsonRecord, version: int) -> None:
    """Check that a manifest has exactly the fields of its schema version.

    Otherwise a newer manifest could be edited, and called an older one to avoid a check.
    path: of the file. record: its content. Raises ArtifactError, naming the first wrong field.
    """
    for place, since, is_present in _fields((), record):
        if since > version and is_present:
            raise later_field_error(path, dotted(place), since, version)
        if version >= FIRST_COMPLETE_VERSION and not is_present:
            raise ArtifactError(
                f"{path}: field {dotted(place)}: expected a value, as in every manifest since schema "
                f"{FIRST_COMPLETE_VERSION}; it is missing. Export again."
            )


def later_field_error(path: Path, field: str, since: int, version: int) -> ArtifactError:
    """The error of a manifest of schema `version` with a field that exists since schema `since`."""
    return ArtifactError(
        f"{path}: field {field}: expected only since schema {since}; got it in a manifest of schema {version}. "
        "The file is damaged or was edited: copy the whole folder, or export again."
    )


def _fields(place: tuple[str | int, ...], value: Any) -> Iterator[tuple[tuple[str | int, ...], int, bool]]:
    """Yield the place of every field of a record and of the records in it, its version, and whether the file has it."""
    if isinstance(value, JsonRecord):
        for name, field in type(value).model_fields.items():
            since = next((item.version for item in field.metadata if isinstance(item, Since)), 1)
            yield (*place, name), since, name in value.model_fields_set
            if not any(isinstance(item, DescribedBy) for item in field.metadata):  # nested as deeply as the file likes
                yield from _fields((*place, name), getattr(value, name))
    elif isinstance(value, dict):
        for key, part in value.items():
            yield from _fields((*place, key), part)
    elif isinstance(value, tuple):
        for index, part in enumerate(value):
            yield from _fields((*place, index), part)
