"""The verdict of the user's `parity` command on a bundle: the only judge of a fault in a bundle."""

import contextlib
import io
import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from duospacenet.cli.main import run_app


@dataclass(frozen=True)
class Verdict:
    """exit_code: of the command. failures: its lines, or the message of a bundle that it refuses."""

    exit_code: int
    failures: tuple[str, ...]

    @property
    def is_caught(self) -> bool:
        """The command says that the bundle differs (1), or that it is not a valid bundle (4)."""
        return self.exit_code in (1, 4)


def run_parity(bundle: Path, *options: str) -> Verdict:
    """Run `duospacenet parity` on a bundle of random weights from seed 0."""
    out, messages = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(messages):
        code = run_app(["parity", str(bundle), "--random-weights", "--json", *(options or ("--seed", "0"))])
    try:
        return Verdict(code, tuple(json.loads(out.getvalue())["failures"]))
    except ValueError:
        return Verdict(code, tuple(messages.getvalue().strip().splitlines()[-1:]))


def judge(bundle: Path, inject: Callable[[Path], Any], folder: Path, *options: str) -> Verdict:
    """Put a fault into a copy of `bundle`, and run the command on the copy."""
    copied = Path(shutil.copytree(bundle, folder / "bundle"))
    try:
        inject(copied)
        return run_parity(copied, *options)
    finally:
        shutil.rmtree(copied)
