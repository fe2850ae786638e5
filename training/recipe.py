"""Recipes: the settings of a training as a readable TOML file."""

import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import fields
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from ..runtime.errors import InputError, UsageError
from ..runtime.files import read_regular_file
from ..runtime.json_record import describe_first_error
from ..runtime.printable import printable
from .settings import Settings

FOLDER = Path(__file__).parent / "recipes"
BUILT_IN = ("cpu", "paper")
MAX_BYTES = 1_000_000  # a recipe has about 4,000
NAMES = tuple(field.name for field in fields(Settings) if field.name != "recipe")
_SHORT_NUMBER = re.compile(r"[+-]?(\d+\.|\.\d+)(e[+-]?\d+)?", re.IGNORECASE | re.ASCII)  # not TOML: `.5`, `1.`


def read_recipe(recipe: str) -> Settings:
    """Read a recipe by its name, "cpu" or "paper", or from a `.toml` file.

    Settings that the file leaves out have the values of the recipe "cpu". A file gives `steps` or `epochs`, not both.

    Raises UsageError for an unknown name. Raises InputError, naming the file and the setting, if the file cannot be
    read or a value is not allowed.
    """
    path = FOLDER / f"{recipe}.toml" if recipe in BUILT_IN else Path(recipe)
    if path.suffix != ".toml":
        raise UsageError(f"--recipe: expected {', '.join(BUILT_IN)} or a .toml file; got {printable(recipe)!r}.")
    values = _parse(path)
    if unknown := [name for name in values if name not in NAMES]:
        raise InputError(f"{path}: {_unknown_name(unknown[0])}")
    if {"steps", "epochs"} <= set(values):
        raise InputError(f"{path}: expected either steps or epochs; got both. Leave one of them out.")
    try:
        return Settings(recipe=path.stem if recipe in BUILT_IN else path.name, **values)
    except ValidationError as error:
        raise InputError(f"{path}: setting {_first_error(error)}.") from None


def override(recipe: Settings, options: Mapping[str, Any], assignments: Iterable[str] = ()) -> Settings:
    """The settings of a recipe with other values.

    options: values by the name of the setting, from options of the command line; None keeps the recipe's value.
    assignments: further values as `NAME=VALUE`, see `parse_assignments`.

    With another learning rate, the rate of the backbone keeps its ratio to it unless it is given too. Given `steps`
    replace the recipe's epochs, and the other way round.

    Raises UsageError, naming the option, if a value is not allowed or given twice.
    """
    given = {name: value for name, value in options.items() if value is not None}
    assigned = parse_assignments(assignments)
    if twice := sorted(set(given) & set(assigned)):
        raise UsageError(
            f"--set {twice[0]}: expected at most once; got {_option(twice[0])} too. Leave one of them out."
        )
    changes = given | assigned
    if changes.get("steps") is not None and changes.get("epochs") is not None:
        raise UsageError("expected either --steps or --epochs; got both. Leave one of them out.")
    values = recipe.to_dict()
    if "steps" in changes:
        values["epochs"] = None
    try:
        changed = Settings(**values | changes)
        if "learning_rate" in changes and "backbone_learning_rate" not in changes:
            ratio = recipe.backbone_learning_rate / recipe.learning_rate
            changed = Settings(**values | changes | {"backbone_learning_rate": ratio * changed.learning_rate})
    except ValidationError as error:
        place, _, problem = _first_error(error, count=False).partition(":")
        name, *index = place.split(".")
        raise UsageError(f"{'.'.join([_option(name, assigned), *index])}:{problem}.") from None
    return changed


def parse_assignments(assignments: Iterable[str]) -> dict[str, Any]:
    """Values of settings by name, from texts `NAME=VALUE`.

    VALUE is a TOML value, `none`, or text without quotation marks: `0.1`, `true`, `[1, 2]`, `windows`.

    Raises UsageError for a text without `=`, an unknown name, or a name that occurs twice.
    """
    values: dict[str, Any] = {}
    for assignment in assignments:
        name, equals, text = assignment.partition("=")
        if not equals:
            raise UsageError(f"--set: expected NAME=VALUE; got {printable(assignment)!r}.")
        if name not in NAMES:
            raise UsageError(f"--set: {_unknown_name(name)}")
        if name in values:
            raise UsageError(f"--set {name}: expected at most once; got it twice. Leave one of them out.")
        values[name] = _parse_value(text)
    return values


def _parse_value(text: str) -> Any:
    if text == "none":  # TOML has no such value
        return None
    try:
        parsed = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        return float(text) if _SHORT_NUMBER.fullmatch(text) else text
    return parsed["value"] if len(parsed) == 1 else text


def _parse(path: Path) -> dict[str, Any]:
    content = read_regular_file(path, MAX_BYTES, InputError)
    try:
        return tomllib.loads(content.decode("utf-8"))
    except (ValueError, RecursionError) as error:  # not UTF-8, not TOML, or nested too deeply
        raise InputError(f"{path}: expected TOML; it cannot be parsed ({printable(str(error))}).") from None


def _unknown_name(name: str) -> str:
    """The message for an unknown name. It suggests similar names, or lists all names if none is similar."""
    similar = get_close_matches(name, NAMES)
    hint = f"Did you mean {' or '.join(similar)}?" if similar else f"The settings are {', '.join(NAMES)}."
    return f"expected the name of a setting; got {printable(name)!r}. {hint}"


def _first_error(error: ValidationError, count: bool = True) -> str:
    """The first error. Lists of a recipe are tuples in `Settings` only."""
    text = describe_first_error(error, count)
    return text.replace(": Input should be a valid tuple", ": Input should be a list").replace(": Tuple", ": List")


def _option(name: str, assigned: Iterable[str] = ()) -> str:
    return f"--set {name}" if name in assigned else f"--{name.replace('_', '-')}"
