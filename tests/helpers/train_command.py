"""Short calls of `duospacenet train`."""

from collections.abc import Iterable

import pytest

from duospacenet.cli.main import run_app

TRAIN_TINY = ["train", "--preset", "tiny", "--steps", "4", "--batch-size", "1", "--frames-per-clip", "2"]
TRAIN_TINY += ["--warmup-steps", "1", "--amp", "off", "--workers", "0"]


def with_options(command: Iterable[object], *options: object) -> list[str]:
    """The command with these options added. The same options with other values are left out of it."""
    words, added = list(map(str, command)), list(map(str, options))
    names = {word for word in added if word.startswith("--")}
    kept = [
        word
        for before, word in zip(["", *words], words, strict=False)
        if word not in names and not (before in names and not word.startswith("--"))
    ]
    return [*kept, *added]


def run_refused(capfd: pytest.CaptureFixture, *arguments: object) -> tuple[int, str]:
    """Run a command that fails; returns its exit code and its message, which has no traceback."""
    code = run_app(list(map(str, arguments)))
    message = capfd.readouterr().err
    assert "Traceback" not in message
    assert "internal error" not in message
    return code, message
