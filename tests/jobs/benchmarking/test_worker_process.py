"""The process of a target: its replies, its errors, and how its end is reported."""

import sys
from pathlib import Path

import pytest

from duospacenet.jobs.benchmarking import worker_process
from duospacenet.jobs.benchmarking.targets import Target
from duospacenet.jobs.benchmarking.worker_process import WorkerFailedError, WorkerProcess
from duospacenet.runtime.errors import ArtifactError

TARGET = Target(name="eager", kind="eager", bundle=Path("none"), threads=1)


def start(monkeypatch, tmp_path, code) -> WorkerProcess:
    """A process that runs `code`, which finds the record of the target in the first line of stdin."""
    monkeypatch.setattr(worker_process, "COMMAND", [sys.executable, "-c", code])
    return WorkerProcess(TARGET, tmp_path)


def test_arguments_and_results_pass_through(monkeypatch, tmp_path):
    code = "import json; input(); r = json.loads(input()); print(json.dumps({'result': [r['method'], r['count']]}))"
    with start(monkeypatch, tmp_path, code) as worker:
        assert worker.call("measure", count=3) == ["measure", 3]


def test_an_error_of_the_toolkit_is_raised_again(monkeypatch, tmp_path):
    code = 'input(); input(); print(\'{"error": "ArtifactError", "message": "bad"}\')'
    with start(monkeypatch, tmp_path, code) as worker, pytest.raises(ArtifactError, match=r"^bad$"):
        worker.call("load")


def test_the_last_line_of_an_uncaught_error_is_the_reason(monkeypatch, tmp_path):
    code = "import sys; input(); input(); sys.exit('torch.compile found no compiler \\x1b[2J')"
    with start(monkeypatch, tmp_path, code) as worker, pytest.raises(WorkerFailedError) as caught:
        worker.call("load")
    assert caught.value.target == "eager"
    assert str(caught.value) == "torch.compile found no compiler \\x1b[2J"


def test_a_killed_process_is_reported_with_its_signal(monkeypatch, tmp_path):
    code = "import os; input(); input(); os.kill(os.getpid(), 9)"
    with start(monkeypatch, tmp_path, code) as worker, pytest.raises(WorkerFailedError, match=r"signal 9; .* memory"):
        worker.call("load")


def test_a_process_that_has_ended_already_is_reported(monkeypatch, tmp_path):
    with start(monkeypatch, tmp_path, "input(); raise SystemExit(3)") as worker:
        worker._process.wait()
        with pytest.raises(WorkerFailedError, match="exit code 3"):
            worker.call("load")


def test_the_process_is_killed_at_the_end(monkeypatch, tmp_path):
    with start(monkeypatch, tmp_path, "import time; time.sleep(600)") as worker:
        pass
    assert worker._process.returncode == -9


def test_a_module_of_the_current_folder_is_not_imported(tmp_path, monkeypatch):
    """The process answers, although the folder has a `json` of its own."""
    (tmp_path / "json.py").write_text("raise SystemExit('the wrong module')")
    monkeypatch.chdir(tmp_path)
    with WorkerProcess(TARGET, tmp_path) as worker, pytest.raises(WorkerFailedError, match="expected a bundle folder"):
        worker.call("load")
