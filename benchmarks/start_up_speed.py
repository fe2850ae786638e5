"""The time of `duospacenet COMMAND --help`, and of the imports of other commands.

Usage: python -m benchmarks.start_up_speed [--rounds N] [--bundle BUNDLE] [COMMAND ...]

Prints one line per call: time, processor time, peak memory, and the ratios of its processor time to that of
`python -c pass` and of `python -c "import typer"`. The calls of a round run one after the other, so that other load
slows all of them alike. Processor time depends least on that load. The figures are medians over the rounds.

Targets: 0.3 s on an idle machine, and 1.3 times `import typer` on any machine.
"""

import argparse
import os
import statistics
import sys
import time
from pathlib import Path
from typing import NamedTuple

from duospacenet.cli.commands import COMMANDS
from duospacenet.runtime.cpu import describe_cpu

LARGEST_SECONDS = 0.3
LARGEST_RATIO = 1.3
IMPORTS = ("numpy", "cv2", "onnxruntime", "pydantic", "duospacenet.jobs.inference")


class Usage(NamedTuple):
    """What one process took. memory_mb: its largest resident memory."""

    wall_s: float
    cpu_s: float
    memory_mb: float


def main() -> None:
    parser = argparse.ArgumentParser(description="Time of --help relative to importing typer.")
    parser.add_argument("commands", nargs="*", metavar="COMMAND", help="default: all commands")
    parser.add_argument("--rounds", type=int, default=9, help="runs of each call")
    parser.add_argument("--bundle", type=Path, help="also `duospacenet inspect BUNDLE` and the import of libraries")
    options = parser.parse_args()
    helped = ["", *COMMANDS] if not options.commands else options.commands
    calls = {
        f"duospacenet {command} --help".replace("  ", " "): _command(*command.split(), "--help") for command in helped
    }
    limited = set(calls)
    if options.bundle:
        calls["duospacenet inspect BUNDLE"] = _command("inspect", str(options.bundle))
        calls |= {f"import {module}": [sys.executable, "-c", f"import {module}"] for module in IMPORTS}
    baselines = {code: [sys.executable, "-c", code] for code in ("pass", "import typer")}
    print(f"CPU: {describe_cpu()}; load {os.getloadavg()[0]:.1f}")
    medians = measure(baselines | calls, options.rounds)
    print(f"{'':<34}{'ms':>7}{'CPU ms':>8}{'MB':>6}{'/ pass':>8}{'/ typer':>9}")
    for call, usage in medians.items():
        ratios = [usage.cpu_s / medians[code].cpu_s for code in baselines]
        slow = call in limited and (ratios[1] > LARGEST_RATIO or usage.wall_s > LARGEST_SECONDS)
        numbers = (
            f"{usage.wall_s * 1000:7.0f}{usage.cpu_s * 1000:8.0f}{usage.memory_mb:6.0f}{ratios[0]:8.2f}{ratios[1]:9.2f}"
        )
        print(f"{call:<34}{numbers}{'  above the target' if slow else ''}")


def measure(calls: dict[str, list[str]], rounds: int) -> dict[str, Usage]:
    """Run every call once per round. Returns the medians by call."""
    usages: dict[str, list[Usage]] = {name: [] for name in calls}
    for _ in range(rounds):
        for name, command in calls.items():
            usages[name].append(run(command))
    return {name: Usage(*map(statistics.median, zip(*of_call, strict=True))) for name, of_call in usages.items()}


def run(command: list[str]) -> Usage:
    """Run a command without its output. Raises RuntimeError if it fails."""
    quiet = [(os.POSIX_SPAWN_OPEN, stream, os.devnull, os.O_WRONLY, 0) for stream in (1, 2)]
    start_s = time.perf_counter()
    process = os.posix_spawn(command[0], command, os.environ, file_actions=quiet)
    _, status, used = os.wait4(process, 0)
    wall_s = time.perf_counter() - start_s
    if status:
        raise RuntimeError(f"exit code {os.waitstatus_to_exitcode(status)}: {' '.join(command)}")
    return Usage(wall_s, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024)


def _command(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "duospacenet.cli.main", *arguments]


if __name__ == "__main__":
    main()
