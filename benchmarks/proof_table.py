"""The tables of docs/results/parity-and-latency.md: export presets with proof, and run them over a source.

    python -m benchmarks.proof_table out/proof tiny nano small --source synthetic:11:12
    python -m benchmarks.proof_table out/ablations 'nano-*' 'small-*'

Each command runs in its own process. A preset uses its shipped weights, or random weights if none are shipped. With
--source, the bundle stays in OUT/PRESET/bundle and the results in OUT/PRESET/run.
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
from duospacenet.runtime.cpu import describe_cpu

WEIGHTS = Path(__file__).resolve().parents[1] / "weights"


@dataclass(frozen=True)
class Measured:
    """A successful command: its JSON output, its wall time [s] and its peak memory [GB]."""

    report: dict[str, Any]
    seconds: float
    memory_gb: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("presets", nargs="+", help="names, or patterns of names")
    parser.add_argument("--source", help="run each bundle over this source, with maps if it has map classes")
    options = parser.parse_args()
    presets = [name for pattern in options.presets for name in PRESETS if fnmatchcase(name, pattern)]
    unknown = [pattern for pattern in options.presets if not any(fnmatchcase(name, pattern) for name in PRESETS)]
    if unknown:
        parser.error(f"no preset has the name {', '.join(unknown)}; known presets: {', '.join(PRESETS)}")
    print(describe_cpu() + "\n")
    print_head("preset", "worst graph output", "boxes", "scores", "maps", "disturbed inputs", "export with proof")
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


def prove(folder: Path, preset: str, source: str | None) -> Measured:
    """Export a preset and print its row. Returns the run over the source, or the export if there is no source."""
    shutil.rmtree(folder, ignore_errors=True)
    bundle = folder / "bundle"
    shipped = WEIGHTS / f"{preset}.safetensors"
    weights = ["--weights", shipped] if shipped.exists() else ["--random-weights"]
    exported = call("export", "--preset", preset, *weights, "--out", bundle)
    print(row(preset, exported), flush=True)
    if source is None:
        shutil.rmtree(bundle)
        return exported
    maps = ["--maps"] if PRESETS[preset].map_classes else []
    return call("run", bundle, source, "--out", folder / "run", *maps)


def row(preset: str, exported: Measured) -> str:
    parity = exported.report["parity"]
    outputs = {f"{g}.{n}": error["relative"] for g, tensors in parity["graphs"].items() for n, error in tensors.items()}
    worst = max(outputs, key=lambda name: outputs[name])
    streamed = [f"{max(frame[field] for frame in parity['stream']):.1e}" for field in ("box", "score", "map")]
    elements = f"{sum(parity['elements'].values())} elements, {len(parity['wrong_elements'])} wrong"
    cost = f"{exported.seconds:.0f} s, {exported.memory_gb:.1f} GB"
    return " | ".join(("", f"`{preset}`", f"{outputs[worst]:.1e} (`{worst}`)", *streamed, elements, cost, "")).strip()


def call(*arguments: Any) -> Measured:
    """Run a command with --json. If it fails, end this process with its exit code."""
    command = [sys.executable, "-m", "duospacenet.cli.main", *map(str, arguments), "--json"]
    start_s = time.monotonic()
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        printed = process.stdout.read() if process.stdout else ""
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        sys.exit(process.returncode)
    return Measured(json.loads(printed), time.monotonic() - start_s, usage.ru_maxrss / 1e6)


if __name__ == "__main__":
    main()
