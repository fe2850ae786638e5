"""Output of text that may come from a file: no control character reaches the terminal."""

import json
import os
import pty
import re
import subprocess
import sys
from contextlib import suppress

import pytest
from rich.markup import escape
from rich.table import Table

from duospacenet.cli.console import (
    _stderr_console,
    print_error,
    print_json,
    print_message,
    print_result,
    show_bar,
    show_progress,
)
from duospacenet.cli.main import run_app
from tests.helpers.bundles import edit_manifest
from tests.helpers.processes import popen

HOSTILE = "\x1b[31mcar\x1b[0m \x9b2J \u202egnp"
ESCAPED = "\\x1b[31mcar\\x1b[0m \\x9b2J \\u202egnp"


@pytest.fixture(autouse=True)
def new_console():
    """A console of each test's own: rich reads the environment when a console is made."""
    _stderr_console.cache_clear()
    yield
    _stderr_console.cache_clear()


def without_line_ends(text):
    return text.replace("\n", "")


def test_messages_errors_and_results_are_printable(capsys):
    print_message(HOSTILE)
    print_error(f"{HOSTILE}\nsecond line")
    print_result(HOSTILE, markup=False, soft_wrap=True)
    printed = capsys.readouterr()
    assert printed.err == f"{ESCAPED}\n{ESCAPED}\nsecond line\n"
    assert printed.out == f"{ESCAPED}\n"


def test_colons_in_names_of_sources_are_no_emoji(capsys):
    table = Table("source", title="synthetic:100:16")
    table.add_row("synthetic:100:16")
    print_result(table)
    print_result("synthetic:100:16")
    print_message("synthetic:100:16")
    printed = capsys.readouterr()
    assert printed.out.count("synthetic:100:16") == 3
    assert printed.err == "synthetic:100:16\n"


def test_cells_titles_and_markup_are_printable(capsys):
    table = Table("name", title=escape(HOSTILE))
    table.add_row(escape(HOSTILE))
    print_result(table)
    print_result(f"[bold]name[/bold] {escape(HOSTILE)}", soft_wrap=True)
    printed = capsys.readouterr().out
    assert without_line_ends(printed).isprintable()
    assert "\\x1b" in printed
    assert printed.endswith(f"name {ESCAPED}\n")


def test_styles_still_reach_a_terminal(capsys, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm-256color")
    print_result(f"[red]refused[/red] {escape(HOSTILE)}", soft_wrap=True)
    assert capsys.readouterr().out == f"\x1b[31mrefused\x1b[0m {ESCAPED}\n"


@pytest.mark.parametrize("is_terminal", [False, True])
def test_the_description_of_a_progress_bar_is_printable(capsys, monkeypatch, is_terminal):
    if is_terminal:
        monkeypatch.setenv("FORCE_COLOR", "1")
    assert list(show_progress([1, 2], f"reading {HOSTILE}")) == [1, 2]
    printed = capsys.readouterr().err
    assert "\x9b" not in printed
    assert "\u202e" not in printed
    assert "\x1b[31mcar" not in printed
    assert "\\x1b" in printed


def test_json_is_one_line_of_printable_ascii_with_the_same_values(capsys):
    value = {HOSTILE: ["\x7f", "\ud800", "é\n"]}
    print_json(value)
    line = capsys.readouterr().out
    assert json.loads(line) == value
    assert line.count("\n") == 1
    assert line.strip().isascii()
    assert line.strip().isprintable()


@pytest.mark.parametrize("command", ["inspect", "run", "check-rig", "eval", "parity", "config"])
def test_a_path_with_escape_sequences_is_printed_with_escapes(tmp_path, capfd, command):
    missing = str(tmp_path / HOSTILE)
    arguments = {
        "inspect": [missing],
        "run": [missing, "synthetic:1:1", "--out", str(tmp_path / "out")],
        "check-rig": [missing, "--out", str(tmp_path / "out")],
        "eval": [missing, "synthetic:1:1"],
        "parity": [missing, "--random-weights"],
        "config": ["show", HOSTILE],
    }[command]
    assert run_app([command, *arguments]) in (2, 3, 4)
    printed = capfd.readouterr()
    assert printed.out == ""
    assert "\\x1b" in printed.err
    assert without_line_ends(printed.err).isprintable()


def test_names_in_a_manifest_cannot_change_the_terminal_or_add_lines(copied_bundle, capfd):
    def edit(manifest):
        manifest["classes"][0] = HOSTILE
        manifest["weights"]["source"] = "nano\nparity     passed"
        manifest["versions"]["torch"] = "\x1b]0;title\x07"

    edit_manifest(copied_bundle, edit)
    assert run_app(["inspect", str(copied_bundle)]) == 0
    printed = capfd.readouterr()
    assert without_line_ends(printed.out + printed.err).isprintable()
    assert "\\x1b[31mcar" in without_line_ends(printed.out)
    assert "nano\\nparity     passed" in without_line_ends(printed.out)


BAR_WITH_MESSAGES = """
from duospacenet.cli.console import print_message, show_bar
for number in show_bar(range(3), "training", 3):
    print_message(f"step {number}")
"""


def test_messages_during_a_progress_bar_have_lines_of_their_own_in_a_terminal():
    """The text after the last carriage return of a line is what the terminal shows."""
    leader, follower = pty.openpty()
    process = popen([sys.executable, "-c", BAR_WITH_MESSAGES], stderr=follower, stdin=subprocess.DEVNULL)
    os.close(follower)
    written = b""
    with suppress(OSError):  # the end of a pseudo-terminal
        while part := os.read(leader, 4096):
            written += part
    os.close(leader)
    assert process.wait(timeout=60) == 0
    lines = [re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", line) for line in written.decode().split("\r\n")]
    assert [shown for line in lines if "step" in (shown := line.rpartition("\r")[2])] == ["step 0", "step 1", "step 2"]
    assert any("training" in line for line in lines)


def test_a_bar_shows_nothing_in_a_pipe(capsys):
    assert list(show_bar(iter("abc"), "training", 3)) == ["a", "b", "c"]
    printed = capsys.readouterr()
    assert printed.out == printed.err == ""
