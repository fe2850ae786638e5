"""JSON records: JSON files from untrusted sources, checked field by field against a declared type."""

from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError
from pydantic.config import JsonDict
from pydantic_core import PydanticCustomError

from .errors import DuoSpaceNetError
from .files import read_regular_file
from .printable import has_control_character, shortened
from .strict_json import JsonError, dotted, parse_strict_json

MAX_JSON_BYTES = 10**9  # a scene with boxes has about 20 KB per frame

# Strict: pydantic would otherwise accept the string "2.0" or the boolean true as a number.
Flag = Annotated[bool, Field(strict=True)]
Integer = Annotated[int, Field(strict=True)]
FiniteFloat = Annotated[float, Field(strict=True, allow_inf_nan=False)]
PositiveInt = Annotated[int, Field(strict=True, gt=0)]
PositiveFloat = Annotated[float, Field(strict=True, gt=0, allow_inf_nan=False)]


def _refuse_boolean(value: Any) -> Any:
    # In Python True equals 1, so a literal 1 would accept it.
    if isinstance(value, bool):
        raise PydanticCustomError("int_type", "Input should be a valid integer")
    return value


FirstVersion = Annotated[Literal[1], BeforeValidator(_refuse_boolean)]


def _check_name(name: str) -> str:
    if has_control_character(name):
        raise PydanticCustomError("name", "expected text without control characters")
    return name


# In a JSON Schema, the characters of `has_control_character` that JSON can hold.
_WITHOUT_CONTROL_CHARACTERS: JsonDict = {"not": {"pattern": r"[\u0000-\u001f\u007f-\u009f\u2028-\u202e\u2066-\u2069]"}}

Name = Annotated[  # also for paths
    str, AfterValidator(_check_name), Field(json_schema_extra=_WITHOUT_CONTROL_CHARACTERS)
]


class JsonRecord(BaseModel):
    """A JSON object with exactly the declared fields. Unknown fields are errors."""

    model_config = ConfigDict(frozen=True, extra="forbid")


RecordType = TypeVar("RecordType", bound=JsonRecord)


def read_json(
    path: Path, record_type: type[RecordType], error: type[DuoSpaceNetError], max_bytes: int = MAX_JSON_BYTES
) -> RecordType:
    """Read the file `path` as a `record_type`.

    Raises `error`, naming the file, the first wrong field, what was expected there and what was found. A file that is
    not regular or has more than `max_bytes` bytes is not opened.
    """
    return check_record(path, parse_json(path, read_regular_file(path, max_bytes, error), error), record_type, error)


def parse_json(path: Path, content: bytes, error: type[DuoSpaceNetError]) -> dict[str, Any]:
    """Parse the content of a JSON file, which must be an object. Raises `error`, naming the file `path`."""
    try:
        value = parse_strict_json(content)
    except JsonError as cause:
        raise error(f"{path}: {cause}") from None
    if not isinstance(value, dict):
        raise error(f"{path}: expected a JSON object; got {shortened(value)}.")
    return value


def check_record(
    path: Path, value: dict[str, Any], record_type: type[RecordType], error: type[DuoSpaceNetError]
) -> RecordType:
    """Check a JSON object field by field. Raises `error`, naming the file `path` and the first wrong field."""
    try:
        return record_type.model_validate(value)
    except ValidationError as failure:
        raise error(f"{path}: field {describe_first_error(failure)}.") from None


def describe_first_error(failure: ValidationError, count: bool = True) -> str:
    """Describe the first wrong field: its path, what was expected and found.

    count: also give the number of wrong fields, if there are several.
    """
    first, *others = failure.errors()
    has_value = first["type"] == "missing" or "; got " in first["msg"]
    got = "" if has_value else f"; got {shortened(first['input'])}"
    more = f" (wrong fields in all: {len(others) + 1})" if others and count else ""
    return f"{dotted(first['loc'])}: {first['msg']}{got}{more}"
