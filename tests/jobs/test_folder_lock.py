"""The lock of an output folder, on local disks, on NFS, and on file systems without locks."""

import errno
import fcntl
import os
import subprocess
import sys
import threading

import pytest

from duospacenet.cli.main import run_app
from duospacenet.jobs.folder_lock import LOCK_NAME, lock_folder
from duospacenet.runtime.errors import OutputError

flock = fcntl.flock


def nfs_flock(descriptor: int, operation: int) -> None:
    """Linux's NFS client: an exclusive lock needs a descriptor that is open for writing."""
    if fcntl.fcntl(descriptor, fcntl.F_GETFL) & os.O_ACCMODE == os.O_RDONLY:
        raise OSError(errno.EBADF, "Bad file descriptor")
    flock(descriptor, operation)


def flock_that_fails(number: int):
    def fail(*_):
        raise OSError(number, os.strerror(number))

    return fail


@pytest.fixture(params=["local", "nfs"])
def file_system(request, monkeypatch) -> str:
    if request.param == "nfs":
        monkeypatch.setattr("fcntl.flock", nfs_flock)
    return request.param


def test_a_locked_folder_cannot_be_locked_again_until_it_is_released(file_system, tmp_path):
    for _ in range(2):
        with lock_folder(tmp_path, notify=pytest.fail):
            with pytest.raises(OutputError, match="another run is writing there"), lock_folder(tmp_path):
                pass
            assert [path.name for path in tmp_path.iterdir()] == ([LOCK_NAME] if file_system == "nfs" else [])
        assert not list(tmp_path.iterdir())


HOLD = """
import fcntl, sys, time
from pathlib import Path
from tests.jobs.test_folder_lock import nfs_flock
if sys.argv[2] == "nfs":
    fcntl.flock = nfs_flock
from duospacenet.jobs.folder_lock import lock_folder
with lock_folder(Path(sys.argv[1])):
    print("locked", flush=True)
    time.sleep(600)
"""


def test_a_folder_is_free_again_when_the_process_that_locked_it_was_killed(file_system, tmp_path):
    command = [sys.executable, "-c", HOLD, str(tmp_path), file_system]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "locked\n"
        with pytest.raises(OutputError, match="another run is writing there"), lock_folder(tmp_path):
            pass
        process.kill()
    with lock_folder(tmp_path, notify=pytest.fail):
        pass
    assert not list(tmp_path.iterdir())


def test_of_many_threads_one_at_a_time_holds_the_lock(file_system, tmp_path):
    """The lock file is removed again and again, while others are about to lock it."""
    holders, most, entered = [], [], []

    def lock_often():
        for _ in range(300):
            try:
                with lock_folder(tmp_path):
                    holders.append(1)
                    most.append(len(holders))
                    os.sched_yield()
                    entered.append(holders.pop())
            except OutputError:
                pass

    threads = [threading.Thread(target=lock_often) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(entered) > 10
    assert max(most) == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS])
def test_a_run_on_a_file_system_without_locks_gets_a_warning(tiny_bundle, tmp_path, monkeypatch, capfd, number):
    monkeypatch.setattr("fcntl.flock", flock_that_fails(number))
    out = tmp_path / "out"
    assert run_app(["run", str(tiny_bundle), "synthetic:5:1", "--out", str(out)]) == 0
    assert "this file system has no locks. Do not start a second run there." in capfd.readouterr().err
    assert sorted(path.name for path in out.iterdir()) == ["results.jsonl", "run.json"]


def test_a_lock_held_on_an_smb_server_is_recognised(tmp_path, monkeypatch):
    monkeypatch.setattr("fcntl.flock", flock_that_fails(errno.EACCES))
    with pytest.raises(OutputError, match="another run is writing there"), lock_folder(tmp_path):
        pass


def test_other_errors_of_a_lock_are_reported(tmp_path, monkeypatch):
    monkeypatch.setattr("fcntl.flock", flock_that_fails(errno.EIO))
    with pytest.raises(OutputError, match="cannot be locked"), lock_folder(tmp_path):
        pass


def test_a_link_with_the_name_of_the_lock_file_is_not_followed(tmp_path, monkeypatch):
    monkeypatch.setattr("fcntl.flock", nfs_flock)
    out = tmp_path / "out"
    out.mkdir()
    (out / LOCK_NAME).symlink_to(tmp_path / "elsewhere")
    with pytest.raises(OutputError, match="cannot be locked"), lock_folder(out):
        pass
    assert not (tmp_path / "elsewhere").exists()


def test_the_lock_file_of_a_killed_process_does_not_stop_the_next_run(tiny_bundle, tmp_path, monkeypatch):
    monkeypatch.setattr("fcntl.flock", nfs_flock)
    (tmp_path / LOCK_NAME).touch()
    assert run_app(["run", str(tiny_bundle), "synthetic:5:1", "--out", str(tmp_path)]) == 0
    assert not (tmp_path / LOCK_NAME).exists()
