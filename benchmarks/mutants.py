"""Mutation testing: a sample of mutants is tested, and the survivors are printed.

    python -m benchmarks.mutants PATH... [--count N] [--seed S] [--log FILE]

A mutant is a copy of the repository with one mutation in one of the files (or folders of files) PATH, see
`ast_mutations`. The tests at the mirrored path run first, for example tests/runtime/test_history*.py for
runtime/history.py, then those of its package. A mutant is killed if a test fails, or if the tests take ten times as
long as usual. A survivor is a gap in the tests, or a mutant that behaves like the original.

Each mutant runs in a forked process, after the large libraries have been imported, so most take a few seconds.
"""

import argparse
import importlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Literal, NamedTuple

import pytest

from benchmarks.ast_mutations import Mutation, find_mutations

ROOT = Path(__file__).resolve().parents[1]
LIBRARIES = ("numpy", "cv2", "onnx", "pydantic", "rich.console", "typer", "torch", "hypothesis")
# Tests of files that are not at the mirrored path, or not only.
OTHER_TESTS = {
    "runtime/json_record.py": ("tests/data/test_scene_folder.py", "tests/data/test_anchors_file.py"),
    "runtime/lost_cameras.py": ("tests/reliability/test_streams.py",),
    "runtime/bundle/graph_file.py": ("tests/reliability/test_bundles.py",),
    "runtime/bundle/bundle_files.py": ("tests/reliability/test_bundles.py",),
}
SHORTEST_TIME_LIMIT_S = 60.0
PASSED, NO_TESTS = 0, 5  # exit codes of pytest

Verdict = Literal["killed", "timeout", "survived"]


class Mutant(NamedTuple):
    """A mutation of one file. path: relative to the repository."""

    path: Path
    mutation: Mutation


class Stage(NamedTuple):
    """Tests that run together. time_limit_s: ten times their time without a mutation."""

    tests: tuple[str, ...]
    time_limit_s: float


def main() -> None:
    parser = argparse.ArgumentParser(description="Test a sample of mutants and print the survivors.")
    parser.add_argument("paths", nargs="+", type=Path, metavar="PATH", help="file or folder to mutate")
    parser.add_argument("--count", type=int, default=150, help="number of mutants (default %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the sample (default %(default)s)")
    parser.add_argument("--mirrored", action="store_true", help="leave out the second stage, the tests of the package")
    parser.add_argument("--log", type=Path, help="file to append one JSON line per mutant to")
    options = parser.parse_args()
    mutants = sample_mutants(options.paths, options.count, options.seed)
    verdicts = Counter[Verdict]()
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        laboratory = Laboratory(Path(folder), options.mirrored)
        for number, mutant in enumerate(mutants, 1):
            verdict = laboratory.judge(mutant)
            verdicts[verdict] += 1
            line = mutant.mutation
            if options.log:
                record = {"path": str(mutant.path), "line": line.line, "before": line.before, "after": line.after}
                with options.log.open("a") as file:
                    file.write(json.dumps(record | {"verdict": verdict}) + "\n")
            if verdict == "survived":
                print(f"{mutant.path}:{line.line}: {_short(line.before)}  ->  {_short(line.after)}", flush=True)
            print(f"{number} of {len(mutants)}: {dict(verdicts)}", file=sys.stderr, flush=True)
    print(f"{len(mutants)} mutants: " + ", ".join(f"{count} {verdict}" for verdict, count in verdicts.items()))


def sample_mutants(paths: list[Path], count: int, seed: int) -> list[Mutant]:
    """A sample of all mutants of the files, ordered by file, so that the same tests run in sequence."""
    files = [file for path in paths for file in (sorted(path.rglob("*.py")) if path.is_dir() else [path])]
    mutants = [
        Mutant(file.resolve().relative_to(ROOT), mutation)
        for file in files
        for mutation in find_mutations(file.read_text(encoding="utf-8"))
    ]
    chosen = random.Random(seed).sample(range(len(mutants)), min(count, len(mutants)))
    return [mutants[index] for index in sorted(chosen)]


class Laboratory:
    """A copy of the repository in which mutants are tested."""

    def __init__(self, folder: Path, only_mirrored: bool) -> None:
        """Copy the repository, import the large libraries, and export the tiny bundle that the tests use."""
        self._root, self._scratch = folder / "repository" / "main", folder / "scratch"
        self._bundle, self._only_mirrored = folder / "tiny", only_mirrored
        self._stages: dict[tuple[str, ...], Stage] = {}
        _copy_repository(self._root, folder / "packages")
        self._scratch.mkdir()
        os.environ["PYTHONPATH"] = os.pathsep.join((str(folder / "packages"), str(self._root)))  # of child processes
        os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
        sys.path[:0] = [str(folder / "packages"), str(self._root)]
        sys.dont_write_bytecode = True  # compiled files could be older than a mutation of the same second
        for name in [name for name in sys.modules if name.partition(".")[0] in ("benchmarks", "duospacenet", "tests")]:
            del sys.modules[name]
        os.chdir(self._root)
        for name in LIBRARIES:
            importlib.import_module(name)
        export = (sys.executable, "-m", "duospacenet.cli.main", "export", "--preset", "tiny", "--random-weights")
        subprocess.run([*export, "--out", self._bundle], check=True, capture_output=True)

    def judge(self, mutant: Mutant) -> Verdict:
        """Test a mutant, and restore the file."""
        stages = [self._stage(tests) for tests in self._test_stages(mutant.path)]
        file = self._root / mutant.path
        original = file.read_bytes()
        try:
            file.write_text(mutant.mutation.source, encoding="utf-8")
            for stage in stages:
                code = self._run(stage.tests, stage.time_limit_s)
                if code is None:
                    return "timeout"
                if code not in (PASSED, NO_TESTS):
                    return "killed"
            return "survived"
        finally:
            file.write_bytes(original)

    def _test_stages(self, path: Path) -> Iterator[tuple[str, ...]]:
        """The tests of a file: those at its mirrored path and in OTHER_TESTS, then all of its package."""
        folder = Path("tests", path.parent)
        mirrored = [str(folder / test.name) for test in sorted((self._root / folder).glob(f"test_{path.stem}*.py"))]
        if first := (*mirrored, *OTHER_TESTS.get(path.as_posix(), ())):
            yield first
        if not (first and self._only_mirrored):
            yield (str(folder if (self._root / folder).is_dir() else Path("tests", path.parts[0])),)

    def _stage(self, tests: tuple[str, ...]) -> Stage:
        """The stage of these tests, which must pass without a mutation."""
        if tests not in self._stages:
            start_s = time.monotonic()
            code = self._run(tests, 3600)
            if code not in (PASSED, NO_TESTS):
                raise SystemExit(
                    f"{' '.join(tests)}: expected tests that pass without a mutation; got exit code {code}"
                )
            duration_s = time.monotonic() - start_s
            self._stages[tests] = Stage(tests, max(SHORTEST_TIME_LIMIT_S, 10 * duration_s))
        return self._stages[tests]

    def _run(self, tests: tuple[str, ...], time_limit_s: float) -> int | None:
        """Run tests in a forked process. Returns the exit code of pytest, or None if it took too long."""
        child = os.fork()
        if not child:
            self._run_in_child(tests)
        end_s = time.monotonic() + time_limit_s
        while time.monotonic() < end_s:
            done, status = os.waitpid(child, os.WNOHANG)
            if done:
                return os.waitstatus_to_exitcode(status)
            time.sleep(0.02)
        os.killpg(child, signal.SIGKILL)
        os.waitpid(child, 0)
        return None

    def _run_in_child(self, tests: tuple[str, ...]) -> None:
        """Run tests and end this process with the exit code of pytest."""
        code = 1
        try:
            os.setsid()
            output = os.open(self._scratch / "output.txt", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(output, 1)
            os.dup2(output, 2)
            self._reuse_bundle()
            base = tempfile.mkdtemp(dir=self._scratch)
            arguments = ["-x", "-q", "-p", "no:cacheprovider", "-m", "not slow", f"--basetemp={base}", *tests]
            code = int(pytest.main(arguments))
            shutil.rmtree(base, ignore_errors=True)
        finally:
            os._exit(code)

    def _reuse_bundle(self) -> None:
        """Let tests copy the tiny bundle of the original code. Its export takes longer than most tests."""
        exports = importlib.import_module("tests.helpers.exports")

        def copy_bundle(model: object, out: Path) -> dict[str, object]:
            shutil.copytree(self._bundle, out)
            return {}

        exports.export_with_traces = copy_bundle


def _copy_repository(root: Path, packages: Path) -> None:
    """Copy the files that git does not ignore, and link the packages as `make` does in the environment."""
    files = subprocess.check_output(["git", "ls-files", "-co", "--exclude-standard"], cwd=ROOT, text=True).splitlines()
    for name in filter(lambda name: (ROOT / name).is_file(), files):
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / name, root / name)
    (packages / "duospacenet").mkdir(parents=True)
    folders = [path for path in root.iterdir() if path.is_dir() and any(path.glob("*.py")) and path.name != "package"]
    for path in [*folders, *(root / "package").iterdir()]:
        (packages / "duospacenet" / path.name).symlink_to(path)
    if (ROOT.parent / "shared").exists():
        (root.parent / "shared").symlink_to(ROOT.parent / "shared")


def _short(text: str) -> str:
    line = " ".join(text.split())
    return line if len(line) <= 100 else f"{line[:97]}..."


if __name__ == "__main__":
    main()
