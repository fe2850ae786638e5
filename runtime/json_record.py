"""Reading JSON that somebody else wrote: checked field by field, refused with the field's name."""

import json
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from .errors import DuoSpaceNetError

FiniteFloat = Annotated[float, Field(strict=True, allow_inf_nan=False)]
PositiveInt = Annotated[int, Field(strict=True, gt=0)]
PositiveFloat = Annotated[float, Field(strict=True, gt=0, allow_inf_nan=False)]


class JsonRecord(BaseModel):
    """A JSON object of known fields and no others."""

    model_config = ConfigDict(frozen=True, extra="forbid")


RecordType = TypeVar("RecordType", bound=JsonRecord)


def read_json(path: Path, contract: type[RecordType], error: type[DuoSpaceNetError]) -> RecordType:
    """Read `path` as `contract`. Raises `error`, naming the file, the field, what was expected and got."""
    try:
        text = path.read_bytes().decode("utf-8")
    except FileNotFoundError:
        raise error(f"{path}: expected a JSON file; got no such file.") from None
    except (OSError, UnicodeDecodeError) as cause:
        raise error(f"{path}: cannot be read as UTF-8 text ({cause}).") from None
    try:
        value = json.loads(text)
    except (ValueError, RecursionError) as cause:  # not JSON; an integer of thousands of digits; too deep
        raise error(f"{path}: expected JSON; got {len(text)} characters that are not ({cause}).") from None
    try:
        return contract.model_validate(value)
    except ValidationError as failure:
        raise error(f"{path}: field {describe_first_error(failure)}.") from None


def describe_first_error(failure: ValidationError) -> str:
    """The first field that is wrong, what was expected and got there, and how many more are."""
    first, *others = failure.errors()
    place = ".".join(map(str, first["loc"])) or "the top"
    got = f"; got {_brief(first['input'])}" if first["type"] != "missing" else ""
    more = f" ({len(others)} more fields are wrong)" if others else ""
    return f"{place}: {first['msg']}{got}{more}"


def float64_array(values: Any) -> NDArray[np.float64]:
    """Nested JSON lists, already checked, as float64."""
    return np.asarray(values, dtype=np.float64)


def _brief(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
