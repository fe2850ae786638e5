"""Model configurations as TOML or JSON files, for models that are not exactly a preset."""

import json
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..runtime.errors import InputError
from ..runtime.extras import needs_extra
from ..runtime.json_record import parse_json
from ..runtime.printable import printable

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
    values = _parse(path)
    try:
        return DuoSpaceNetConfig.from_dict(values)
    except ValueError as error:
        raise InputError(f"{path}: field {error}.") from None


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
    if kind == "json":
        return parse_json(path, content, InputError)
    try:
        return tomllib.loads(content.decode("utf-8"))
    except (ValueError, RecursionError) as error:  # not UTF-8, not TOML, or nested too deeply
        raise InputError(f"{path}: expected TOML; it cannot be parsed ({printable(str(error))}).") from None
