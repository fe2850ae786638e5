"""The model configuration that training stores in the metadata of a checkpoint."""

from pathlib import Path
from typing import Any

from ..runtime.strict_json import parse_strict_json
from .checkpoint_error import CheckpointError
from .checkpoint_file import read_metadata

CONFIG_KEY = "config"  # metadata key; the value is the JSON of `DuoSpaceNetConfig.to_dict()`


def read_config(path: str | Path) -> dict[str, Any] | None:
    """Read the configuration in a checkpoint's metadata. None if the checkpoint has none.

    The values are not checked: `DuoSpaceNetConfig.from_dict` does that.
    Raises CheckpointError if the file or its configuration cannot be parsed, and OSError if the file does not exist
    or there is no permission to read it.
    """
    path = Path(path)
    text = read_metadata(path).get(CONFIG_KEY)
    if text is None:
        return None
    try:
        values = parse_strict_json(text.encode())
    except ValueError as error:  # JsonError, or text that cannot be encoded
        raise _not_a_config(path, str(error)) from None
    if not isinstance(values, dict):
        raise _not_a_config(path, f"it is a JSON {type(values).__name__}")
    return values


def _not_a_config(path: Path, cause: str) -> CheckpointError:
    return CheckpointError(
        f"{path}: expected a JSON object in the metadata field {CONFIG_KEY!r}; it cannot be parsed ({cause}). "
        "Name the configuration yourself, with --preset or --config."
    )
