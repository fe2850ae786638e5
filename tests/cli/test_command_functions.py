"""Rules for every command function: its length, its help, and defaults that are written a second time."""

import inspect
from importlib import import_module
from typing import get_args, get_type_hints

import pytest
import typer

from duospacenet.cli import anchors, export
from duospacenet.cli.commands import COMMANDS
from duospacenet.cli.main import run_app
from duospacenet.data.anchor_clustering import DEFAULT_RANGE_M
from duospacenet.data.anchors_file import LARGEST_RANGE_M
from duospacenet.jobs.anchor_job import MAX_SEED
from duospacenet.runtime.bundle.manifest import DeformableForm
from duospacenet.runtime.bundle.operators import DEFAULT_OPSET, OPSETS

FUNCTION_COMMANDS = [name for name in COMMANDS if name not in ("config", "package")]


def function_of(command: str):
    module, name = COMMANDS[command].place.split(":")
    return getattr(import_module(f"duospacenet.cli.{module}"), name)


@pytest.mark.parametrize("command", FUNCTION_COMMANDS)
def test_a_command_function_has_at_most_25_lines_after_its_options(command):
    """Docstring and body. The signature has one line per option."""
    body = inspect.getsource(function_of(command)).partition(") -> None:\n")[2]
    assert 0 < len(body.splitlines()) <= 25


@pytest.mark.parametrize("command", FUNCTION_COMMANDS)
def test_the_help_has_an_example_and_fits_80_columns(command, monkeypatch, capfd):
    monkeypatch.setenv("COLUMNS", "80")
    assert run_app([command, "--help"]) == 0
    printed = capfd.readouterr().out
    assert f"Usage: duospacenet {command}" in printed
    assert f"\n    duospacenet {command} " in printed
    assert max(map(len, printed.splitlines())) <= 80


def test_the_limits_of_anchors_are_those_of_the_toolkit():
    """The command has copies of them, because its help must not import numpy."""
    hints = get_type_hints(anchors.anchors, include_extras=True)
    range_m, seed = (option_in(hints[name]) for name in ("range_m", "seed"))
    default_range_m = inspect.signature(anchors.anchors).parameters["range_m"].default
    assert (default_range_m, range_m.max, seed.max) == (DEFAULT_RANGE_M, LARGEST_RANGE_M, MAX_SEED)


def test_the_forms_of_deformable_convolutions_are_those_of_the_manifest():
    hints = get_type_hints(export.export)
    assert get_args(hints["dcn"]) == get_args(DeformableForm)


def test_the_operator_sets_are_those_of_the_toolkit():
    hints = get_type_hints(export.export, include_extras=True)
    assert option_in(hints["opset"]).metavar == "|".join(map(str, OPSETS))
    assert inspect.signature(export.export).parameters["opset"].default == DEFAULT_OPSET


def option_in(annotated) -> "typer.models.OptionInfo":
    return annotated.__metadata__[0]
