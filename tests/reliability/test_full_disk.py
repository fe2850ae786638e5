"""Full disks: row P1 of the reliability list."""

import json
import os
import resource
import subprocess
from pathlib import Path

import pytest

from duospacenet.cli.main import run_app
from duospacenet.data.results import ResultsFile
from duospacenet.runtime.errors import OutputError
from duospacenet.runtime.files import write_atomically
from tests.helpers.processes import call


def limit_files(size: int):
    """For a child process: no file can be larger than `size` bytes, as on a full disk."""
    return lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))


def test_p1_a_failed_write_leaves_the_old_file_and_no_other(tmp_path):
    path = tmp_path / "a.bin"
    path.write_bytes(b"old")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 20, hard))
    try:
        with pytest.raises(OutputError, match=r"a\.bin: File too large"):
            write_atomically(path, bytes(2 << 20))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_p1_a_file_is_on_disk_before_it_gets_its_name(tmp_path, monkeypatch):
    """Otherwise a power failure could leave an empty file under the final name."""
    order = []
    fsync, replace = os.fsync, Path.replace
    monkeypatch.setattr(os, "fsync", lambda descriptor: order.append("fsync") or fsync(descriptor))
    monkeypatch.setattr(Path, "replace", lambda path, target: order.append("replace") or replace(path, target))
    write_atomically(tmp_path / "a.bin", b"new")
    assert order == ["fsync", "replace"]
    assert (tmp_path / "a.bin").read_bytes() == b"new"


def test_p1_a_line_that_does_not_fit_leaves_no_part_of_it(tmp_path):
    record = {"boxes": ["x" * 1000]}
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    with ResultsFile(tmp_path / "results.jsonl") as lines:
        resource.setrlimit(resource.RLIMIT_FSIZE, (2500, hard))
        try:
            lines.write(record)
            lines.write(record)
            with pytest.raises(OutputError, match=r"results\.jsonl: File too large"):
                lines.write(record)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        lines.write({"boxes": []})
    written = [json.loads(line) for line in (tmp_path / "results.jsonl").read_text().splitlines()]
    assert written == [record, record, {"boxes": []}]


@pytest.mark.parametrize(
    ("options", "limit"), [([], 150_000), (["--draw"], 60_000), (["--format", "nuscenes"], 400_000)]
)
def test_p1_a_run_on_a_full_disk_ends_with_5_and_leaves_complete_files(tiny_bundle, tmp_path, options, limit):
    out = tmp_path / "out"
    done = call(["run", tiny_bundle, "synthetic:5:9", "--out", out, *options], preexec_fn=limit_files(limit))
    assert done.returncode == 5
    assert "cannot write" in done.stderr
    assert "File too large" in done.stderr
    assert "Traceback" not in done.stderr
    lines = (out / "results.jsonl").read_text().splitlines()
    assert len(lines) < 9
    assert all(len(json.loads(line)["boxes"]) == 320 for line in lines)
    assert not [path for path in out.rglob(".*") if path.is_file()]
    assert run_app(["run", str(tiny_bundle), "synthetic:5:9", "--out", str(out), "--resume", *options]) == 0
    assert len((out / "results.jsonl").read_text().splitlines()) == 9


def test_p1_an_export_on_a_full_disk_leaves_nothing(tmp_path):
    arguments = ["export", "--preset", "tiny", "--random-weights", "--out", tmp_path / "bundle"]
    done = call(arguments, preexec_fn=limit_files(1000))
    assert done.returncode == 5
    assert "Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("arguments", [["inspect", "{bundle}"], ["inspect", "{bundle}", "--json"]])
def test_p1_a_full_standard_output_is_reported(tiny_bundle, arguments):
    with open("/dev/full", "w") as full:  # noqa: PTH123
        done = call([argument.format(bundle=tiny_bundle) for argument in arguments], **redirected_to(full))
    assert done.returncode == 5
    assert "No space left on device" in done.stderr
    assert "Traceback" not in done.stderr
    assert "Exception ignored" not in done.stderr


def redirected_to(stdout) -> dict:
    return {"capture_output": False, "stdout": stdout, "stderr": subprocess.PIPE}
