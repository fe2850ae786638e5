"""The command list: help, panels, version and shell completion, without the import of a large package."""

import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import duospacenet
from duospacenet.cli.commands import COMMANDS, load_command
from duospacenet.cli.main import run_app
from tests.helpers.processes import call

HEAVY = {"torch", "onnxruntime", "onnx", "cv2", "numpy", "scipy", "pydantic", "rich.console", "tomli_w"}
CALLS = ["", *COMMANDS, "config show"]

LIST_MODULES = """
import sys
from duospacenet.cli.main import run_app
code = run_app(sys.argv[1:])
print(*sys.modules, file=sys.stderr)
raise SystemExit(code)
"""


@pytest.mark.parametrize("command", CALLS)
def test_help_imports_none_of_the_large_packages(command):
    call = [sys.executable, "-c", LIST_MODULES, *command.split(), "--help"]
    done = subprocess.run(call, capture_output=True, text=True, check=True)
    assert done.stdout.startswith(f"Usage: duospacenet {command}".rstrip())
    assert not HEAVY & set(done.stderr.split())


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


def test_completion_imports_none_of_the_large_packages():
    asked = {"_DUOSPACENET_COMPLETE": "complete_bash", "COMP_WORDS": "duospacenet ", "COMP_CWORD": "1"}
    code = LIST_MODULES.replace(
        "code = run_app(sys.argv[1:])", "try:\n    run_app([])\nexcept SystemExit:\n    code = 0"
    )
    done = subprocess.run([sys.executable, "-c", code], env=os.environ | asked, capture_output=True, text=True)
    assert set(COMMANDS) <= set(done.stdout.split())
    assert not HEAVY & set(done.stderr.split())


def test_the_completion_script_can_be_shown():
    named = {"_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"}
    done = call(["--show-completion", "bash"], env=os.environ | named)
    assert done.returncode == 0
    assert "_duospacenet_completion" in done.stdout
