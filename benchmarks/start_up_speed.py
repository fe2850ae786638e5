"""The time of `duospacenet COMMAND --help`, and of the imports of other commands.

Usage: python -m benchmarks.start_up_speed [--rounds N] [--bundle BUNDLE] [COMMAND ...]

Prints one line per call: time, processor time, and the ratios of its processor time to that of
`python -c pass` and of `python -c "import typer"`. The calls of a round run one after the other, so that other load
slows all of them alike. Processor time depends least on that load. The figures are medians over the rounds.

Targets for help: at most 0.3 s of processor time, and 1.5 times that of `import typer`.
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
LARGEST_RATIO = 1.5
BASELINES = ("pass", "import typer")
IMPORTS = ("numpy", "cv2", "onnxruntime", "pydantic", "duospacenet.jobs.inference")


class Times(NamedTuple):
    """The time that a process took, and its processor time."""

    wall_s: float
    cpu_s: float


def main() -> None:
    parser = argparse.ArgumentParser(description="Time of --help relative to importing typer.")
    parser.add_argument("commands", nargs="*", metavar="COMMAND", help="default: all commands")
    parser.add_argument("--rounds", type=int, default=9, help="runs of each call")
    parser.add_argument("--bundle", type=Path, help="also time `duospacenet inspect BUNDLE` and imports of libraries")
    options = parser.parse_args()
    helped = {
        f"{command} --help".strip(): [*command.split(), "--help"] for command in options.commands or ["", *COMMANDS]
    }
    calls = {f"duospacenet {name}": _command(*arguments) for name, arguments in helped.items()}
    baselines = {code: [sys.executable, "-c", code] for code in BASELINES}
    others = {} if options.bundle is None else _other_calls(options.bundle)
    print(f"CPU: {describe_cpu()}; load {os.getloadavg()[0]:.1f}")
    medians = measure(baselines | calls | others, options.rounds)
    print(f"{'':<34}{'ms':>7}{'CPU ms':>8}{'/ pass':>8}{'/ typer':>9}")
    for call, times in medians.items():
        to_pass, to_typer = (times.cpu_s / medians[code].cpu_s for code in BASELINES)
        slow = call in calls and (to_typer > LARGEST_RATIO or times.cpu_s > LARGEST_SECONDS)
        numbers = f"{times.wall_s * 1000:7.0f}{times.cpu_s * 1000:8.0f}{to_pass:8.2f}{to_typer:9.2f}"
        print(f"{call:<34}{numbers}{'  above the target' if slow else ''}")


def _other_calls(bundle: Path) -> dict[str, list[str]]:
    imports = {f"import {module}": [sys.executable, "-c", f"import {module}"] for module in IMPORTS}
    return {"duospacenet inspect BUNDLE": _command("inspect", str(bundle)), **imports}


def measure(calls: dict[str, list[str]], rounds: int) -> dict[str, Times]:
    """Run every call once per round. Returns the medians by call."""
    times: dict[str, list[Times]] = {name: [] for name in calls}
    for _ in range(rounds):
        for name, command in calls.items():
            times[name].append(run(command))
    return {name: Times(*map(statistics.median, zip(*of_call, strict=True))) for name, of_call in times.items()}


def run(command: list[str]) -> Times:
    """Run a command without its output. Raises RuntimeError if it fails."""
    quiet = [(os.POSIX_SPAWN_OPEN, stream, os.devnull, os.O_WRONLY, 0) for stream in (1, 2)]
    start_s = time.perf_counter()
    process = os.posix_spawn(command[0], command, os.environ, file_actions=quiet)
    _, status, used = os.wait4(process, 0)
    wall_s = time.perf_counter() - start_s
    if status:
        raise RuntimeError(f"exit code {os.waitstatus_to_exitcode(status)}: {' '.join(command)}")
    return Times(wall_s, used.ru_utime + used.ru_stime)


def _command(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "duospacenet.cli.main", *arguments]


if __name__ == "__main__":
    main()
