"""An option that is given twice never silently keeps the last value: of all commands."""

import pytest
from typer.core import TyperGroup, TyperOption

from duospacenet.cli.commands import COMMANDS, load_command
from duospacenet.cli.main import run_app


def all_options():
    """Every option of every command, with the words that call its command."""
    for name in COMMANDS:
        command = load_command(name)
        commands = command.commands if isinstance(command, TyperGroup) else {"": command}
        for subname, each in commands.items():
            words = [name, subname] if subname else [name]
            for parameter in each.params:
                if isinstance(parameter, TyperOption):
                    yield words, parameter


def is_single(option):
    return not option.multiple and (not option.is_flag or option.secondary_opts)


SINGLE_OPTIONS = {
    f"{' '.join(words)} {option.opts[0]}": (words, option) for words, option in all_options() if is_single(option)
}


@pytest.mark.parametrize("name", SINGLE_OPTIONS)
def test_an_option_with_one_value_is_refused_if_it_is_given_twice(name, capfd):
    words, option = SINGLE_OPTIONS[name]
    first, second = [option.opts[0]], [(*option.secondary_opts, option.opts[0])[0]]
    if not option.is_flag:
        first, second = [*first, "3"], [f"{second[0]}=4"]
    assert run_app([*words, *first, *second]) == 2
    error = capfd.readouterr().err
    assert f"{option.opts[0]}" in error
    assert "expected at most once; got it 2 times" in error
    assert f"See `duospacenet {' '.join(words)} --help`." in error


def test_the_options_of_every_command_are_tested():
    assert {name.split()[0] for name in SINGLE_OPTIONS} == set(COMMANDS)
    assert len(SINGLE_OPTIONS) > 80


def test_lists_and_plain_flags_may_be_repeated(tmp_path, capfd):
    """Both calls pass the check of repeated options, and fail at the missing file."""
    missing = str(tmp_path / "none")
    assert run_app(["inspect", missing, "--json", "--json"]) == 4
    assert run_app(["quantize", missing, "--source", "a", "--source", "b", "--out", str(tmp_path / "out")]) == 4
    assert "at most once" not in capfd.readouterr().err


def test_shell_completion_of_a_repeated_option_is_no_error():
    command = load_command("run")
    context = command.make_context("run", ["a", "b", "--out", "x", "--out", "y"], resilient_parsing=True)
    assert str(context.params["out"]) == "y"
