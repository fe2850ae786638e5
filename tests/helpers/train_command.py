"""Short calls of `duospacenet train`."""

import pytest

from duospacenet.cli.main import run_app

TRAIN_TINY = ["train", "--preset", "tiny", "--steps", "4", "--batch-size", "1", "--frames-per-clip", "2"]
TRAIN_TINY += ["--warmup-steps", "1", "--no-bf16", "--workers", "0"]


def run_refused(capfd: pytest.CaptureFixture, *arguments: object) -> tuple[int, str]:
    """Run a command that fails; returns its exit code and its message, which has no traceback."""
    code = run_app(list(map(str, arguments)))
    message = capfd.readouterr().err
    assert "Traceback" not in message
    assert "internal error" not in message
    return code, message
