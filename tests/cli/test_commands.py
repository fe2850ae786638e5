"""The command list: help, panels, version and shell completion, without the import of a large module."""

import os
import tomllib
from pathlib import Path

import pytest

import duospacenet
from duospacenet.cli.commands import COMMANDS, load_command
from duospacenet.cli.main import run_app
from tests.helpers.blocked_imports import call_without
from tests.helpers.processes import call

LARGE_MODULES = ["numpy", "cv2", "onnxruntime", "pydantic", "torch", "onnx", "openvino", "scipy", "matplotlib"]
LARGE_MODULES += ["rich.console", "tomli_w"]


def all_calls() -> list[str]:
    """Each command and subcommand; the command list itself is the empty text."""
    subcommands = {name: getattr(load_command(name), "commands", {}) for name in COMMANDS}
    return ["", *COMMANDS, *(f"{name} {subcommand}" for name in COMMANDS for subcommand in subcommands[name])]


def test_the_calls_include_subcommands():
    assert {"", "run", "inspect", "config", "config show"} <= set(all_calls())


@pytest.mark.parametrize("command", all_calls())
def test_help_imports_none_of_the_large_modules(command):
    done = call_without(LARGE_MODULES, [*command.split(), "--help"])
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith(f"Usage: duospacenet {command}".rstrip())


def test_the_version_imports_none_of_the_large_modules():
    done = call_without(LARGE_MODULES, ["--version"])
    assert (done.stdout, done.stderr) == (f"duospacenet {duospacenet.__version__}\n", "")


def test_help_lists_every_command_with_its_summary(capsys):
    assert run_app(["--help"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    for name, entry in COMMANDS.items():
        assert f"{name} {entry.summary}" in text


def test_without_arguments_the_help_is_printed(capsys):
    assert run_app([]) == 0
    without = capsys.readouterr().out
    assert run_app(["--help"]) == 0
    assert capsys.readouterr().out == without


@pytest.mark.parametrize("command", COMMANDS)
def test_every_option_of_a_command_has_a_help_text(command):
    for parameter in load_command(command).params:
        assert parameter.help, parameter.name


def test_options_are_grouped_in_panels(capsys):
    assert run_app(["export", "--help"]) == 0
    text = capsys.readouterr().out
    places = [text.index(f"\n{panel}:\n") for panel in ("Input", "Output", "Behaviour", "Advanced", "Options")]
    assert places == sorted(places)
    assert places[0] < text.index("\n  --preset") < places[1] < text.index("\n  --out") < places[2]
    assert text.index("\n  --help") > places[4]


def test_the_version_is_printed(capsys):
    assert run_app(["--version"]) == 0
    assert capsys.readouterr().out == f"duospacenet {duospacenet.__version__}\n"


def test_the_version_has_one_source():
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())
    stated = project["project"].get("version", duospacenet.__version__)  # absent where it is read from the package
    assert stated == duospacenet.__version__


def test_the_shell_completes_commands_and_options():
    def complete(*words: str) -> list[str]:
        asked = {
            "_DUOSPACENET_COMPLETE": "complete_bash",
            "COMP_WORDS": " ".join(words),
            "COMP_CWORD": f"{len(words) - 1}",
        }
        return call([], env=os.environ | asked).stdout.split()

    assert complete("duospacenet", "ex") == ["export"]
    assert complete("duospacenet", "export", "--rand") == ["--random-weights"]


@pytest.mark.parametrize(
    ("words", "expected", "modules"),
    [
        ("duospacenet ", "export", LARGE_MODULES),
        # typer converts the values of the other options by pydantic.
        ("duospacenet run --over", "--overwrite", [name for name in LARGE_MODULES if name != "pydantic"]),
    ],
)
def test_completion_imports_none_of_the_large_modules(words, expected, modules):
    asked = {"_DUOSPACENET_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": f"{words.count(' ')}"}
    done = call_without(modules, [], env=os.environ | asked)
    assert expected in done.stdout.split()
    assert done.stderr == ""


def test_the_completion_script_can_be_shown():
    named = {"_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"}
    done = call(["--show-completion", "bash"], env=os.environ | named)
    assert done.returncode == 0
    assert "_duospacenet_completion" in done.stdout
