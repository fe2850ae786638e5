"""The replacement of files: a process that is killed before any file operation leaves a state that is completed."""

import os
import shutil
from pathlib import Path

import pytest

from duospacenet.jobs.replacement import Replacement
from duospacenet.runtime.errors import OutputError
from tests.helpers.output_files import contents

PATTERNS = ("run.json", "results.jsonl", "pictures/[0-9].png", "maps/[0-9].png")
EARLIER = {"run.json": b"a", "results.jsonl": b"aaa", "pictures/0.png": b"a0", "pictures/1.png": b"a1"}
FINISHED_RUN = {"run.json": b"b", "results.jsonl": b"bb", "pictures/0.png": b"b0", "maps/0.png": b"m0"}
MINE = {"pictures/mine.png": b"mine", "notes.txt": b"mine"}


def replacement(out: Path) -> Replacement:
    return Replacement(out, PATTERNS)


@pytest.fixture
def out(tmp_path) -> Path:
    staged = {f".duospacenet-new/{name}": content for name, content in FINISHED_RUN.items()}
    for name, content in (EARLIER | staged | MINE).items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(content)
    return tmp_path


def test_files_of_the_earlier_run_are_replaced_or_removed_and_other_files_stay(out):
    replacement(out).replace_earlier()
    assert contents(out) == FINISHED_RUN | MINE
    assert not replacement(out).is_pending
    replacement(out).complete()
    assert contents(out) == FINISHED_RUN | MINE


OPERATIONS = {Path: ("replace", "rename", "unlink", "mkdir"), os: ("unlink", "rmdir")}


def kill_before(number: int, out: Path, monkeypatch) -> bool:
    """Replace the files in a child process that ends before file operation `number`. Returns whether it was reached."""
    process = os.fork()
    if process == 0:
        done = 0
        for owner, names in OPERATIONS.items():
            for name in names:
                original = getattr(owner, name)

                def counted(*arguments, original=original, **options):
                    nonlocal done
                    done += 1
                    if done > number:
                        os._exit(9)
                    return original(*arguments, **options)

                monkeypatch.setattr(owner, name, counted)
        replacement(out).replace_earlier()
        os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]) == 9


def test_a_killed_process_leaves_complete_results_and_a_state_that_is_completed(out, tmp_path, monkeypatch):
    number, states = 0, set()
    while True:
        copy = shutil.copytree(out, tmp_path.parent / f"killed {number}")
        if not kill_before(number, copy, monkeypatch):
            break
        assert (copy / "results.jsonl").read_bytes() in (b"aaa", b"bb")
        states.add(replacement(copy).is_pending)
        if replacement(copy).is_pending:
            replacement(copy).complete()
            assert contents(copy) == FINISHED_RUN | MINE
        elif replacement(copy).new.exists():
            assert {name: contents(copy)[name] for name in EARLIER} == EARLIER
        else:
            assert contents(copy) == FINISHED_RUN | MINE
        number += 1
    assert number >= 8
    assert states == {True, False}


def test_files_are_moved_to_another_file_system(out, monkeypatch):
    """`pictures` may be a link to a larger disk."""
    rename = Path.replace

    def replace(path: Path, target: Path) -> Path:
        if ".duospacenet-moving" in path.parts and "pictures" in path.parts:
            raise OSError(18, "Invalid cross-device link")
        return rename(path, target)

    monkeypatch.setattr(Path, "replace", replace)
    replacement(out).replace_earlier()
    assert contents(out) == FINISHED_RUN | MINE


def test_a_link_in_place_of_the_folder_is_not_followed(tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "run.json").write_bytes(b"mine")
    replacement(tmp_path).new.symlink_to(tmp_path / "mine")
    with pytest.raises(OutputError, match="cannot be removed"):
        replacement(tmp_path).discard_new()
    assert (tmp_path / "mine" / "run.json").read_bytes() == b"mine"
