"""The entry point: help, version, completion, exit codes, and how a command ends when its surroundings break."""

import json
import os
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import pytest

import duospacenet
from duospacenet.cli.commands import COMMANDS, load_command
from duospacenet.cli.main import run_app
from tests.helpers.processes import COMMAND, call

HEAVY = {"torch", "onnxruntime", "onnx", "cv2", "numpy", "scipy", "pydantic", "rich.console", "tomli_w"}
CALLS = ["", *COMMANDS, "config show"]

# --- help, version and completion ---------------------------------------------------------------------------------

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


# --- exit codes ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["exprt"], "No such command 'exprt'. Did you mean 'export'? See duospacenet COMMAND --help."),
        (["export", "--nope"], "No such option: --nope. See duospacenet COMMAND --help."),
        (["config"], "Missing command. See duospacenet COMMAND --help."),
    ],
)
def test_a_wrong_call_ends_with_2(capsys, arguments, message):
    assert run_app(arguments) == 2
    assert capsys.readouterr().err == f"error: {message}\n"


def test_an_internal_error_ends_with_70_and_no_traceback(monkeypatch, capsys):
    monkeypatch.setattr("duospacenet.jobs.config_file.config_to_toml", lambda _: 1 / 0)
    assert run_app(["config", "show", "tiny"]) == 70
    message = capsys.readouterr().err
    assert message.startswith("internal error: ZeroDivisionError: division by zero\n")
    assert "DUOSPACENET_TRACEBACK=1" in message
    assert "Traceback" not in message


def test_a_developer_can_ask_for_the_traceback(monkeypatch):
    monkeypatch.setattr("duospacenet.jobs.config_file.config_to_toml", lambda _: 1 / 0)
    monkeypatch.setenv("DUOSPACENET_TRACEBACK", "1")
    with pytest.raises(ZeroDivisionError):
        run_app(["config", "show", "tiny"])


def test_every_error_class_has_an_exit_code_of_its_own():
    errors = import_module("duospacenet.runtime.errors")
    classes = errors.DuoSpaceNetError.__subclasses__()
    codes = {error.exit_code for error in classes if error.__module__ == errors.__name__}
    assert codes == {1, 2, 3, 4, 5, 6}
    assert (errors.INTERNAL_ERROR_EXIT_CODE, errors.INTERRUPTED_EXIT_CODE) == (70, 130)


# --- closed and broken standard streams ---------------------------------------------------------------------------

PRINTING = [
    ["--help"],
    ["run", "--help"],
    ["config", "show", "tiny"],
    ["inspect", "{bundle}"],
    ["inspect", "{bundle}", "--json"],
]


@pytest.fixture
def broken_pipe() -> Iterator[int]:
    """The writing end of a pipe without a reader."""
    reader, writer = os.pipe()
    os.close(reader)
    yield writer
    os.close(writer)


@pytest.mark.parametrize("arguments", PRINTING)
def test_a_command_ends_quietly_if_the_reader_of_its_output_has_gone(tiny_bundle, broken_pipe, arguments):
    done = call([part.format(bundle=tiny_bundle) for part in arguments], **captured_stderr(stdout=broken_pipe))
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("arguments", PRINTING)
def test_a_command_ends_quietly_if_stdout_is_closed(tiny_bundle, arguments):
    closed = captured_stderr(stdout=None, preexec_fn=lambda: os.close(1))
    done = call([part.format(bundle=tiny_bundle) for part in arguments], **closed)
    assert (done.returncode, done.stderr) == (0, "")


def captured_stderr(**options) -> dict:
    return {"capture_output": False, "stderr": subprocess.PIPE} | options


def test_a_failed_command_keeps_its_exit_code_without_a_reader(tmp_path, broken_pipe):
    for options in ({"stdout": broken_pipe}, {"stdout": None, "preexec_fn": lambda: os.close(1)}):
        done = call(["inspect", tmp_path / "none", "--json"], **captured_stderr(**options))
        assert done.returncode == 4
        assert done.stderr.startswith("error: ")
    no_streams = {"capture_output": False, "preexec_fn": lambda: (os.close(1), os.close(2))}
    assert call(["inspect", tmp_path / "none"], **no_streams).returncode == 4


def test_a_run_without_standard_streams_writes_its_results(tiny_bundle, tmp_path):
    """A file that is opened first must not become stdout."""
    closed = {"capture_output": False, "preexec_fn": lambda: [os.close(descriptor) for descriptor in range(3)]}
    done = call(["run", tiny_bundle, "synthetic:5:2", "--out", tmp_path, "--json"], **closed)
    assert done.returncode == 0
    assert len([json.loads(line) for line in (tmp_path / "results.jsonl").read_text().splitlines()]) == 2


def test_a_character_that_the_encoding_lacks_becomes_a_question_mark(tmp_path):
    ascii_only = {"LC_ALL": "C", "LANG": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    done = subprocess.run(
        [*COMMAND, "inspect", str(tmp_path / "écran")], env=os.environ | ascii_only, capture_output=True, check=False
    )
    assert done.returncode == 4
    assert b"Traceback" not in done.stderr
