"""The README's tables: presets exported and proven, and run over a source, each in a process of its own.

    python tests/proof_table.py out/proof tiny nano small --source synthetic:11:12
    python tests/proof_table.py out/ablations 'nano-*' 'small-*'

Weights are those that ship for a preset, or else random. A preset's bundle is left in OUT/PRESET/bundle, unless it is
not run; what ran, in OUT/PRESET/run.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from duospacenet.model import PRESETS

WEIGHTS = Path(__file__).resolve().parents[1] / "weights"


@dataclass(frozen=True)
class Done:
    """A command that ended well: its JSON, how long it took, the most memory it held."""

    report: dict[str, Any]
    seconds: float
    memory_gb: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("presets", nargs="+", help="names, or patterns of names")
    parser.add_argument("--source", help="run the bundle over it, with maps where it draws them")
    options = parser.parse_args()
    presets = [name for pattern in options.presets for name in PRESETS if fnmatchcase(name, pattern)]
    idle = [pattern for pattern in options.presets if not any(fnmatchcase(name, pattern) for name in PRESETS)]
    if idle:
        parser.error(f"no preset is called {', '.join(idle)}; known are {', '.join(PRESETS)}")
    print_head("preset", "worst graph output", "boxes", "scores", "maps", "inputs without effect", "export with proof")
    runs = {name: prove(options.out / name, name, options.source) for name in presets}
    if options.source:
        print()
        print_head("preset", "stages, median ms", "peak memory of `run`")
        for name, run in runs.items():
            stages = ", ".join(f"{stage} {ms:.1f}" for stage, ms in run.report["median_ms"].items())
            print(f"| `{name}` | {stages} | {run.memory_gb:.1f} GB |")


def print_head(*names: str) -> None:
    print(f"| {' | '.join(names)} |")
    print("| --- " * len(names) + "|")


def prove(folder: Path, preset: str, source: str | None) -> Done:
    """Export a preset and print its row; returns its run over the source, or the export where there is none."""
    shutil.rmtree(folder, ignore_errors=True)
    bundle = folder / "bundle"
    shipped = WEIGHTS / f"{preset}.safetensors"
    weights = ["--weights", shipped] if shipped.exists() else ["--random-weights"]
    done = call("export", "--preset", preset, *weights, "--out", bundle)
    print(row(preset, done), flush=True)
    if source is None:
        shutil.rmtree(bundle)
        return done
    maps = ["--maps"] if PRESETS[preset].map_classes else []
    return call("run", bundle, source, "--out", folder / "run", *maps)


def row(preset: str, done: Done) -> str:
    proof = done.report["parity"]
    outputs = {f"{g}.{n}": error["relative"] for g, tensors in proof["graphs"].items() for n, error in tensors.items()}
    worst = max(outputs, key=lambda name: outputs[name])
    streamed = [f"{max(frame[what] for frame in proof['stream']):.1e}" for what in ("box", "score", "map")]
    dead = ", ".join(proof["dead_inputs"]) or "none"
    cost = f"{done.seconds:.0f} s, {done.memory_gb:.1f} GB"
    return " | ".join(("", f"`{preset}`", f"{outputs[worst]:.1e} (`{worst}`)", *streamed, dead, cost, "")).strip()


def call(*arguments: Any) -> Done:
    """Run a command with --json. Ends this process where it fails."""
    command = [sys.executable, "-m", "duospacenet.cli.main", *map(str, arguments), "--json"]
    start_s = time.monotonic()
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        printed = process.stdout.read() if process.stdout else ""
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        sys.exit(process.returncode)
    return Done(json.loads(printed), time.monotonic() - start_s, usage.ru_maxrss / 1e6)


if __name__ == "__main__":
    main()
