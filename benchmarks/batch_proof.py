"""Equality and throughput of batches, and batches whose processes are killed.

Usage: python -m benchmarks.batch_proof BUNDLE OUT SOURCE...

The sources are processed by `run`, and by batches with 1 worker, with one worker per core, with 4 workers, and on Ray
with 2. Then a worker is killed with SIGKILL, and after that a whole batch, which is resumed. All batches must write the
same files for each scene, byte for byte, and the same submission as `run`. Exit code 1 otherwise.
"""

import argparse
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from duospacenet.runtime.cores import available_cores
from duospacenet.runtime.cpu import describe_cpu
from tests.helpers.process_tree import child_processes, is_running

COMMAND = [sys.executable, "-m", "duospacenet.cli.main"]
TIMEOUT_S = 3600


def main() -> None:
    parser = argparse.ArgumentParser(description="Equality, throughput and killed processes of batches.")
    parser.add_argument("bundle", type=Path)
    parser.add_argument("out", type=Path, help="folder, whose content is replaced")
    parser.add_argument("sources", nargs="+", metavar="SOURCE")
    options = parser.parse_args()
    cores = available_cores()
    print(f"{describe_cpu()}; {cores} cores; load {os.getloadavg()[0]:.1f}")
    shutil.rmtree(options.out, ignore_errors=True)
    proof = Proof(options.bundle, options.out, options.sources)
    proof.run_whole()
    for workers in dict.fromkeys((1, cores, 4)):
        proof.batch(f"{workers} workers", "--workers", workers)
    proof.batch(f"1 worker, {cores} threads", "--threads", cores, "--workers", 1, must_equal=False)
    proof.batch("Ray, 2 workers", "--ray", "local", "--workers", 2)
    proof.kill_a_worker()
    proof.kill_the_batch()
    sys.exit(0 if proof.all_equal else 1)


class Proof:
    """Compares every batch with the first one, and with the run over all sources.

    all_equal: whether no difference was found.
    """

    def __init__(self, bundle: Path, out: Path, sources: Sequence[str]) -> None:
        self._bundle, self._out, self._sources = bundle, out, sources
        self._submission = ""
        self._scenes: str | None = None
        self.all_equal = True

    def run_whole(self) -> None:
        """Run all sources with one thread. Its submission has the results of all scenes."""
        start_s = time.monotonic()
        out = self._out / "run"
        self._call("run", "--out", out, "--threads", 1)
        self._submission = digest([out / "results_nusc.json"])
        self._print("run, 1 thread", time.monotonic() - start_s, f"submission {self._submission}")

    def batch(self, name: str, *options: object, must_equal: bool = True) -> None:
        """Run a batch and print its throughput."""
        out = self._new_folder(name)
        self._report(name, json.loads(self._call("batch", "--out", out, *options, "--json")), out, must_equal)

    def kill_a_worker(self) -> None:
        """Kill a worker after some frames. Its scene is continued."""
        out = self._new_folder("killed worker")
        process = self._start("--out", out, "--workers", 2)
        wait_for(lambda: count_frames(out) >= 3, process)
        os.kill(child_processes(process.pid)[0], signal.SIGKILL)
        stdout, _ = process.communicate(timeout=TIMEOUT_S)
        self._report("2 workers, one of them killed", json.loads(stdout), out)

    def kill_the_batch(self) -> None:
        """Kill the process of a batch, see how long its workers live, and resume it."""
        out = self._new_folder("killed batch")
        process = self._start("--out", out, "--workers", 2)
        wait_for(lambda: count_frames(out) >= 3, process)
        workers = child_processes(process.pid)
        process.kill()
        process.communicate(timeout=TIMEOUT_S)
        start_s, kept = time.monotonic(), count_frames(out)
        while any(map(is_running, workers)):
            time.sleep(0.01)
        ended_s = time.monotonic() - start_s
        print(f"killed batch: {len(workers)} workers ended after {ended_s:.2f} s, {kept} frames kept")
        summary = json.loads(self._call("batch", "--out", out, "--workers", 2, "--resume", "--json"))
        self._report("2 workers, batch killed and resumed", summary, out)

    def _report(self, name: str, summary: dict[str, Any], out: Path, must_equal: bool = True) -> None:
        files = [path for path in sorted(out.glob("scenes/*/**/*")) if path.is_file() and path.name != "summary.json"]
        scenes = digest(files)
        self._scenes = self._scenes or scenes
        equal = digest([out / "results_nusc.json"]) == self._submission
        equal &= scenes == self._scenes or not must_equal  # `run.json` has the number of threads
        self.all_equal &= (equal or not must_equal) and summary["failed"] == 0
        lost = f", {summary['lost_workers']} lost" if summary["lost_workers"] else ""
        rates = ", ".join(f"{row['frames_per_s']:.2f}" for row in summary["workers"])
        text = f"{summary['new_frames']} frames, {summary['frames_per_s']:.2f} frames/s (workers: {rates}){lost}"
        self._print(name, summary["seconds"], f"{text}; {'equal' if equal else 'different'}")

    def _print(self, name: str, seconds: float, text: str) -> None:
        print(f"{name}: {seconds:.1f} s; {text}", flush=True)

    def _new_folder(self, name: str) -> Path:
        return self._out / "".join(character if character.isalnum() else "-" for character in name)

    def _arguments(self, command: str, options: Sequence[object]) -> list[str]:
        formats = ("--format", "jsonl,nuscenes")
        return [*COMMAND, command, *map(str, (self._bundle, *self._sources, *formats, *options))]

    def _call(self, command: str, *options: object) -> str:
        arguments = self._arguments(command, options)
        return subprocess.run(arguments, stdout=subprocess.PIPE, text=True, check=True, timeout=TIMEOUT_S).stdout

    def _start(self, *options: object) -> subprocess.Popen[str]:
        return subprocess.Popen(self._arguments("batch", [*options, "--json"]), stdout=subprocess.PIPE, text=True)


def digest(files: Sequence[Path]) -> str:
    """The start of the SHA-256 of the files in order."""
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()[:16]


def count_frames(out: Path) -> int:
    """The number of frames in the results so far, of the scenes that are not finished."""
    return sum(path.read_bytes().count(b"\n") for path in out.glob("unfinished/*/results.jsonl"))


def wait_for(condition: Callable[[], bool], process: subprocess.Popen[str]) -> None:
    """Wait until the condition holds. Raises RuntimeError if the process ends before."""
    while not condition():
        if process.poll() is not None:
            raise RuntimeError("the batch ended before it could be killed: give it longer scenes")
        time.sleep(0.05)


if __name__ == "__main__":
    main()
