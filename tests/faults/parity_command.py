"""The verdict of the user's `parity` command on a bundle: the only judge of a fault in a bundle."""

import contextlib
import io
import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

from duospacenet.cli.main import run_app
from duospacenet.export.parity import retraced_graphs


@dataclass(frozen=True)
class Verdict:
    """exit_code: of the command. failures: its lines, or the message of a bundle that it refuses."""

    exit_code: int
    failures: tuple[str, ...]

    @property
    def is_caught(self) -> bool:
        """The command says that the bundle differs (1), or that it is not a valid bundle (4)."""
        return self.exit_code in (1, 4)

    @property
    def is_caught_without_new_export(self) -> bool:
        """Another check than the comparison with a new export says so. It is the only one with other versions."""
        return self.is_caught and not all(line.startswith("new export") for line in self.failures)


def run_parity(bundle: Path, *options: str) -> Verdict:
    """Run `duospacenet parity` on a bundle of the preset `tiny` with random weights. options: by default seed 0."""
    command = ["parity", str(bundle), "--preset", "tiny", "--random-weights", *(options or ("--seed", "0")), "--json"]
    out, messages = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(messages):
        code = run_app(command)
    if code in (0, 1):
        return Verdict(code, tuple(json.loads(out.getvalue())["failures"]))
    return Verdict(code, tuple(messages.getvalue().strip().splitlines()[-1:]))


def judge(bundle: Path, inject: Callable[[Path], Any], folder: Path) -> Verdict:
    """Put a fault into a copy of `bundle`, and run the command on the copy.

    The command's new export gives the graphs of `bundle`, as a new export does. This saves the time of tracing.
    """
    copied = Path(shutil.copytree(bundle, folder / "bundle"))
    try:
        inject(copied)
        with mock.patch.object(
            retraced_graphs, "trace", lambda graph, path, forms: shutil.copy(bundle / path.name, path)
        ):
            return run_parity(copied)
    finally:
        shutil.rmtree(copied)
