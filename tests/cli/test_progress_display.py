"""The progress on stderr: a bar in a terminal, lines in a pipe."""

import io
import itertools

from duospacenet.cli import progress_display
from duospacenet.cli.printable_console import PrintableConsole
from duospacenet.cli.progress_display import display_progress


def shown(terminal, items, seconds_per_item, monkeypatch, total=None, done=0, label=None):
    """The items that pass, the lines, and what is written to the terminal. Time passes between the items only."""
    clock = itertools.count(0, seconds_per_item)
    monkeypatch.setattr(progress_display.time, "monotonic", lambda: next(clock))
    stream, lines = io.StringIO(), []
    console = PrintableConsole(file=stream, force_terminal=terminal, width=120)
    passed = list(display_progress(console, items, "run", total, done, label, lines.append))
    return passed, lines, stream.getvalue()


def test_a_pipe_gets_a_line_at_the_start_and_one_every_half_minute(monkeypatch):
    """Ten seconds per frame. The clock is read once at the start and once per frame."""
    passed, lines, _ = shown(False, range(8), 10, monkeypatch, label=lambda item: f"scene {item}")
    assert passed == list(range(8))
    assert lines == ["run ...", "run: 2 of 8, 0.067/s, 2 min left, scene 2", "run: 5 of 8, 0.083/s, 36 s left, scene 5"]


def test_frames_of_an_interrupted_run_count_as_done_but_not_for_the_rate(monkeypatch):
    """2 frames in 30 s: 1/15 per second, so the 5 frames that are left take 75 s."""
    _, lines, _ = shown(False, range(100, 107), 10, monkeypatch, done=100)
    assert lines[1] == "run: 102 of 107, 0.067/s, 1 min left"


def test_items_without_a_number_have_no_time_left(monkeypatch):
    _, lines, _ = shown(False, iter(range(4)), 10, monkeypatch)
    assert lines[1] == "run: 2, 0.067/s"
    _, lines, _ = shown(False, iter(range(4)), 10, monkeypatch, total=4)
    assert lines[1] == "run: 2 of 4, 0.067/s, 30 s left"


def test_a_short_job_has_one_line_in_a_pipe(monkeypatch):
    assert shown(False, range(5), 0.1, monkeypatch)[1] == ["run ..."]


def test_a_terminal_shows_frames_and_the_label_without_its_control_characters(monkeypatch):
    passed, lines, written = shown(True, range(3), 1, monkeypatch, done=7, label=lambda item: "scene [b]\x07")
    assert (passed, lines) == ([0, 1, 2], [])
    assert "10/10" in written
    assert "scene [b]" in written
    assert "\x07" not in written
