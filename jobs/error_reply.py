"""An error as JSON, as a process replies it to the process that started it."""

from collections.abc import Mapping
from typing import Any

from ..runtime import errors
from ..runtime.errors import DuoSpaceNetError


def error_reply(error: DuoSpaceNetError) -> dict[str, Any]:
    """Return the reply. It names the error's class, or the nearest one that every process knows."""
    name = next(base.__name__ for base in type(error).__mro__ if base.__module__ == errors.__name__)
    return {"error": name, "message": str(error)}


def check_reply(reply: Mapping[str, Any]) -> None:
    """Raise the error that a reply holds, if it holds one."""
    if "error" in reply:
        raise getattr(errors, reply["error"])(reply["message"])
