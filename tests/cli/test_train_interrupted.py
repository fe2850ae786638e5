"""`duospacenet train`: locked folders, interruptions and --resume."""

import errno
import json
import os
import signal
import subprocess
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from duospacenet.cli.main import run_app
from duospacenet.jobs.folder_lock import lock_folder
from duospacenet.jobs.training import training_job
from duospacenet.runtime.errors import InputError
from duospacenet.training import Settings, TrainingFolder
from duospacenet.training.watching.loss_curves import write_loss_curves
from tests.helpers.process_tree import child_processes
from tests.helpers.processes import start, wait_for
from tests.helpers.train_command import run_refused, with_options
from tests.helpers.training_logs import reproducible_lines
from tests.helpers.trainings import new_trainer


def test_two_trainings_do_not_write_into_one_folder(train_tiny, tmp_path, capfd):
    out = tmp_path / "out"
    assert run_app([*train_tiny, "--out", str(out)]) == 0
    before = {path.name: path.stat().st_mtime_ns for path in out.iterdir()}
    with lock_folder(out):
        code, message = run_refused(capfd, *train_tiny, "--out", out, "--resume")
    assert code == 5
    assert "another run is writing there" in message
    assert {path.name: path.stat().st_mtime_ns for path in out.iterdir()} == before
    new = tmp_path / "new"
    new.mkdir()
    with lock_folder(new):
        code, message = run_refused(capfd, *train_tiny, "--out", new)
    assert code == 5
    assert "another run is writing there" in message
    assert list(new.iterdir()) == []


def test_the_later_of_two_simultaneous_trainings_is_refused(train_tiny, tmp_path, capfd, monkeypatch):
    """The other training has locked the folder and ended between the check of this one and its lock."""
    out = tmp_path / "out"

    @contextmanager
    def lock_too_late(folder, notify):
        (folder / "training.json").write_text("another training")
        with lock_folder(folder, notify):
            yield

    monkeypatch.setattr(training_job, "lock_folder", lock_too_late)
    code, message = run_refused(capfd, *train_tiny, "--out", out)
    assert code == 5
    assert "an earlier training wrote this folder" in message
    assert [path.read_text() for path in out.iterdir()] == ["another training"]


def test_a_training_on_a_file_system_without_locks_gets_a_warning(train_tiny, tmp_path, capfd, monkeypatch):
    def no_locks(*_):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr("fcntl.flock", no_locks)
    assert run_app([*train_tiny, "--out", str(tmp_path / "out")]) == 0
    assert "this file system has no locks" in capfd.readouterr().err
    assert not [path for path in (tmp_path / "out").iterdir() if path.name.startswith(".")]


def test_a_resumed_training_equals_an_uninterrupted_one(train_tiny, tmp_path, monkeypatch, capfd):
    """Ctrl-C comes after the first checkpoint, during the second batch of clips."""
    save_all = [*train_tiny, "--save-every", "1"]
    append_steps = TrainingFolder.append_steps

    def interrupted(folder, steps):
        append_steps(folder, steps)
        if steps[0].step.number > 0:
            raise KeyboardInterrupt

    assert run_app([*save_all, "--out", str(tmp_path / "whole")]) == 0
    monkeypatch.setattr(TrainingFolder, "append_steps", interrupted)
    assert run_app([*save_all, "--out", str(tmp_path / "parts")]) == 130
    assert "interrupted; finished results are on disk" in capfd.readouterr().err
    write_loss_curves([], [], tmp_path / "nothing.png")
    assert (tmp_path / "parts" / "losses.png").read_bytes() != (tmp_path / "nothing.png").read_bytes()
    monkeypatch.undo()
    assert run_app([*save_all, "--out", str(tmp_path / "parts"), "--resume"]) == 0
    parts, whole = tmp_path / "parts", tmp_path / "whole"
    assert (parts / "training.json").read_bytes() == (whole / "training.json").read_bytes()
    assert reproducible_lines(parts) == reproducible_lines(whole)
    ours, expected = (load_file(folder / "weights.safetensors") for folder in (parts, whole))
    assert [name for name, tensor in expected.items() if not torch.equal(tensor, ours[name])] == []


@pytest.mark.parametrize("line", ["nonsense\n", '{"step": 9}\n'])
def test_an_error_is_reported_although_the_loss_curves_cannot_be_drawn(train_tiny, tmp_path, monkeypatch, capfd, line):
    append_steps = TrainingFolder.append_steps

    def fails(folder, steps):
        append_steps(folder, steps)
        with (folder.path / "log.jsonl").open("a") as file:
            file.write(line)
        raise InputError("the frames ended")

    monkeypatch.setattr(TrainingFolder, "append_steps", fails)
    code, message = run_refused(capfd, *train_tiny, "--out", tmp_path / "out")
    assert code == 3
    assert message.splitlines()[-1] == "error: the frames ended"
    assert not (tmp_path / "out" / "losses.png").exists()


def test_resuming_a_finished_training_changes_nothing(train_tiny, tmp_path, capfd):
    out = tmp_path / "out"
    assert run_app([*train_tiny, "--out", str(out)]) == 0
    before = (out / "weights.safetensors").read_bytes()
    assert run_app([*train_tiny, "--out", str(out), "--resume", "--json"]) == 0
    assert json.loads(capfd.readouterr().out.splitlines()[-1])["loss"] is None
    assert run_app([*train_tiny, "--out", str(out), "--resume"]) == 0
    assert capfd.readouterr().out.startswith(f"no step was left: {out}/weights.safetensors is complete")
    assert (out / "weights.safetensors").read_bytes() == before


def test_ctrl_c_ends_a_training_and_leaves_a_complete_checkpoint(train_tiny, tmp_path):
    """In a process of its own. As at a terminal, its worker gets the signal too."""
    out = tmp_path / "out"
    options = ["--out", str(out), "--steps", "100000", "--save-every", "1", "--workers", "1"]
    arguments = with_options(train_tiny, *options)
    process = start(arguments, process_group=0)
    assert_interruptible(process, (out / "checkpoint.pt").exists)
    assert not [path for path in out.iterdir() if path.name.startswith(".")]
    settings = Settings.from_dict(json.loads((out / "training.json").read_text())["settings"])
    trainer = new_trainer(settings)
    trainer.load_state_dict(torch.load(out / "checkpoint.pt", weights_only=True))
    assert trainer.step >= 1


def test_ctrl_c_while_workers_start_ends_a_training(train_tiny, tmp_path):
    """The worker is still importing torch at that time."""
    options = ["--out", str(tmp_path / "out"), "--steps", "100000", "--workers", "1"]
    process = start(with_options(train_tiny, *options), process_group=0)
    assert_interruptible(process, lambda: is_importing_torch(process.pid))


def assert_interruptible(process: subprocess.Popen, is_ready: Callable[[], bool]) -> None:
    """Send Ctrl-C to the process group once `is_ready` returns true: the command ends with 130 and a message."""
    try:
        wait_for(lambda: process.poll() is not None or is_ready(), timeout_s=600)
        os.killpg(process.pid, signal.SIGINT)
        _, message = process.communicate(timeout=600)
    finally:
        process.kill()
    assert process.returncode == 130, message
    assert "interrupted; finished results are on disk; add --resume to continue" in message.splitlines()


def is_importing_torch(parent: int) -> bool:
    """Whether a child of this process has started to load torch's libraries (Linux)."""
    return any("libtorch" in Path(f"/proc/{child}/maps").read_text() for child in child_processes(parent))
