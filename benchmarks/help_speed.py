"""The time of `duospacenet --help`, as a ratio to `python -c "import typer, rich"`.

Usage: python -m benchmarks.help_speed [--rounds N] [COMMAND ...]

Prints one line per command; `--help` alone comes first. The ratio should be at most 1.3.
"""

import argparse
import statistics
import subprocess
import sys
import time

from duospacenet.cli.commands import COMMANDS
from duospacenet.runtime.cpu import describe_cpu

BASELINE = [sys.executable, "-c", "import typer, rich"]
LARGEST_RATIO = 1.3


def main() -> None:
    parser = argparse.ArgumentParser(description="Time of --help relative to importing typer and rich.")
    parser.add_argument("commands", nargs="*", metavar="COMMAND", help="default: all commands")
    parser.add_argument("--rounds", type=int, default=15, help="runs of each command, alternating with the baseline")
    options = parser.parse_args()
    print(f"CPU: {describe_cpu()}")
    for command in ("", *(options.commands or COMMANDS)):
        ratio = help_ratio(command.split(), options.rounds)
        note = "" if ratio <= LARGEST_RATIO else f"  above {LARGEST_RATIO}"
        print(f"duospacenet {' '.join([command, '--help']).strip():<20} {ratio:.2f}{note}", flush=True)


def help_ratio(arguments: list[str], rounds: int) -> float:
    """The median over the rounds of (time of `duospacenet ARGUMENTS --help`) / (time of the baseline).

    The two alternate, so that other load on the machine slows both alike.
    """
    command = [sys.executable, "-m", "duospacenet.cli.main", *arguments, "--help"]
    return statistics.median(_seconds(command) / _seconds(BASELINE) for _ in range(rounds))


def _seconds(command: list[str]) -> float:
    start_s = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - start_s


if __name__ == "__main__":
    main()
