"""Model configurations as TOML or JSON files, for models that are not exactly a preset."""

import json
import tomllib
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import TypeAdapter, ValidationError
from pydantic_core import ErrorDetails

from ..runtime.errors import InputError
from ..runtime.extras import needs_extra

if TYPE_CHECKING:
    from ..model import DuoSpaceNetConfig

MAX_CONFIG_BYTES = 1_000_000  # a configuration has about 1,500


def read_config_file(path: Path) -> "DuoSpaceNetConfig":
    """Read a configuration from a `.toml` or `.json` file. Its `preset` field may hold any name.

    Raises InputError, naming the file and the field, if the file cannot be read, a field is unknown or missing, or a
    value is not allowed.
    """
    with needs_extra("export"):
        from ..model import DuoSpaceNetConfig
    text = _to_finite_json(path, _parse(path))
    try:
        # pydantic's strict mode refuses "32" and true where it expects 32. In JSON it accepts a list for a tuple.
        return TypeAdapter(DuoSpaceNetConfig).validate_json(text, strict=True)
    except ValidationError as error:
        raise InputError(f"{path}: {_describe(error)}.") from None


def config_to_toml(config: "DuoSpaceNetConfig") -> str:
    """The configuration as TOML text, which `read_config_file` reads back."""
    with needs_extra("export"):
        import tomli_w
    return tomli_w.dumps(config.to_dict())


def config_to_json(config: "DuoSpaceNetConfig") -> str:
    """The configuration as JSON text, which `read_config_file` reads back."""
    return json.dumps(config.to_dict(), indent=2, allow_nan=False) + "\n"


def _parse(path: Path) -> Any:
    kind = path.suffix.removeprefix(".")
    if kind not in ("toml", "json"):
        raise InputError(f"{path}: expected a file name that ends in .toml or .json. Rename the file.")
    try:
        with path.open("rb") as file:
            content = file.read(MAX_CONFIG_BYTES + 1)
    except OSError as error:
        raise InputError(f"{path}: expected a configuration file; it cannot be read ({error.strerror}).") from None
    if len(content) > MAX_CONFIG_BYTES:
        raise InputError(f"{path}: expected a configuration of at most {MAX_CONFIG_BYTES} bytes; the file is larger.")
    try:
        text = content.decode("utf-8")
        return tomllib.loads(text) if kind == "toml" else json.loads(text)
    except (ValueError, RecursionError) as error:  # not UTF-8, not TOML or JSON, or nested too deeply
        raise InputError(f"{path}: expected {kind.upper()}; it cannot be parsed ({error}).") from None


def _to_finite_json(path: Path, values: Any) -> str:
    try:
        return json.dumps(values, allow_nan=False, default=str)  # default: TOML's dates and times, which no field takes
    except ValueError:
        raise InputError(f"{path}: expected finite numbers; got nan or inf.") from None


def _describe(error: ValidationError) -> str:
    """The first wrong field: its name, the allowed values, the value found; and how many more fields are wrong."""
    from ..model.config import DuoSpaceNetConfig, ImageConfig, ResNetConfig, VoVNetConfig, VoxelGrid

    backbones: dict[int | str, type] = {"ResNetConfig": ResNetConfig, "VoVNetConfig": VoVNetConfig}
    first, *others = _errors_of_one_backbone(error.errors(), list(backbones))
    place = ".".join(str(part) for part in first["loc"] if part not in backbones) or "the top level"
    more = f" ({len(others)} more fields are wrong)" if others else ""
    if first["type"] == "unexpected_keyword_argument":
        tables = {"image": ImageConfig, "voxels": VoxelGrid} | backbones
        table = tables[first["loc"][-2]] if len(first["loc"]) > 1 else DuoSpaceNetConfig
        return f"field {place} is unknown; expected only {', '.join(field.name for field in fields(table))}{more}"
    if first["type"] == "value_error":  # raised by the configuration itself, in its own words
        return f"field {first['msg'].removeprefix('Value error, ').rstrip('.')}{more}"
    got = "" if first["type"].startswith("missing") else f"; got {_shorten(first['input'])}"
    return f"field {place}: {first['msg']}{got}{more}"


def _errors_of_one_backbone(errors: list[ErrorDetails], kinds: list[int | str]) -> list[ErrorDetails]:
    """The errors without those of the backbone that fits worse; pydantic reports the errors of both."""
    by_kind = {kind: [error for error in errors if kind in error["loc"]] for kind in kinds}
    worse = max(kinds, key=lambda kind: len(by_kind[kind]))
    return [error for error in errors if worse not in error["loc"]] if all(by_kind.values()) else errors


def _shorten(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
