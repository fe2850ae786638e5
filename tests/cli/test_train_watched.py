"""`duospacenet train` with --validation, --tensorboard and more --steps on --resume, from end to end."""

import importlib
import json
import os
import random
import re
import signal
import subprocess
import sys
import time

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file

from duospacenet.cli.main import run_app
from duospacenet.data.scene_writer import write_scene
from tests.helpers.processes import start, wait_for
from tests.helpers.train_command import run_refused, with_options
from tests.helpers.training_logs import read_lines, reproducible_lines
from tests.helpers.trainings import synthetic_frames

LINE = re.compile(
    r"step (\d+) of \d+, epoch \d+\.\d\d: loss \d+\.\d{3}, learning rate \d\.\de-\d\d, \d+\.\d\d s per step, "
    r"\d+\.\d frames/s,( waiting for data \d+% of the time \(more --workers help\),)? \d+ s left"
)


@pytest.fixture(scope="module")
def held_out(tmp_path_factory):
    folder = tmp_path_factory.mktemp("held-out") / "scene"
    write_scene(folder, synthetic_frames(2, 2))
    return folder


@pytest.fixture
def train_watched(train_tiny, held_out):
    """A training of four steps in two batches, with a validation after each."""
    return [*train_tiny, "--validation", str(held_out), "--validate-every", "2"]


def same_weights(first, second):
    ours, expected = load_file(first), load_file(second)
    return all(torch.equal(tensor, ours[name]) for name, tensor in expected.items())


def test_a_training_is_validated_and_keeps_the_best_weights(train_watched, tmp_path, capfd):
    out = tmp_path / "out"
    assert run_app([*train_watched, "--out", str(out)]) == 0
    printed = capfd.readouterr()
    scores = [line["validation"] for line in read_lines(out) if "validation" in line]
    best = max((0, 1), key=lambda index: scores[index]["NDS"])
    with safe_open(out / "best.safetensors", "pt") as file:
        metadata = file.metadata()
    assert metadata["step"] == str(2 * best + 2)
    assert json.loads(metadata["validation"]) == {**scores[best], "best_by": "NDS"}
    lines = [line for line in printed.err.splitlines() if line.startswith(("step", "validation"))]
    assert [line.partition(":")[0].partition(",")[0] for line in lines] == [
        "step 1 of 4",
        "validation after step 2",
        "step 3 of 4",
        "step 4 of 4",
        "validation after step 4",
    ]
    assert all(LINE.fullmatch(line) for line in lines if line.startswith("step"))
    assert f"NDS {scores[1]['NDS']:.3f}" in lines[-1]
    assert "\x1b" not in printed.err  # a pipe gets no control codes
    assert "eval" not in printed.err
    assert (out / "losses.png").exists()
    assert run_app(["export", "--weights", str(out / "best.safetensors"), "--dry-run"]) == 0
    assert "accepted" in capfd.readouterr().out


def test_an_extended_training_says_so_and_its_weights_name_it(train_watched, training_scene, tmp_path, capfd):
    """One of the two held-out sources is trained on."""
    out, train_watched = tmp_path / "out", [*train_watched, "--validation", str(training_scene)]
    assert run_app([*with_options(train_watched, "--steps", "3"), "--out", str(out)]) == 0
    assert run_app([*with_options(train_watched, "--steps", "6"), "--out", str(out), "--resume", "--json"]) == 0
    printed = capfd.readouterr()
    assert "warning: --validation: 3 of 5 frames are trained on as well (synthetic-1-000000, " in printed.err
    assert "the training is extended from 3 to 6 steps; after step 3, the learning rate follows" in printed.err
    assert json.loads(printed.out.splitlines()[-1])["steps"] == 6
    lines = read_lines(out)
    assert [line["step"] for line in lines if "validation" not in line] == list(range(6))  # 3 is within a batch
    assert [line["step"] for line in lines if "validation" in line] == [2, 3, 5, 6]
    with safe_open(out / "weights.safetensors", "pt") as file:
        metadata = file.metadata()
    assert (metadata["step"], metadata["steps"]) == ("6", "6")
    assert json.loads(metadata["extended"]) == [{"at_step": 3, "old_steps": 3, "new_steps": 6}]


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (["--validate-every", "5"], 2, "--validate-every: expected only with --validation SOURCE; got none"),
        (["--validation", "missing"], 3, "missing"),
        (["--validation", "synthetic:1:1", "--pretraining"], 2, "--validation: expected a training of the whole model"),
        (["--validation", "synthetic:1:1", "--validate-every", "0"], 2, "--validate-every"),
    ],
)
def test_a_wrong_validation_is_refused_before_anything_is_written(train_tiny, tmp_path, capfd, options, code, words):
    result, message = run_refused(capfd, *with_options(train_tiny, "--out", tmp_path / "out", *options))
    assert (result, words in message) == (code, True)
    assert not (tmp_path / "out").exists()


# --- TensorBoard --------------------------------------------------------------------------------------------------


def test_tensorboard_logs_need_their_extra(train_tiny, tmp_path, capfd, monkeypatch):
    for name in [name for name in sys.modules if name.startswith(("tensorboard", "torch.utils.tensorboard"))]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.delitem(sys.modules, "duospacenet.training.watching.tensorboard_log", raising=False)
    monkeypatch.delattr(importlib.import_module("duospacenet.training.watching"), "tensorboard_log", raising=False)
    monkeypatch.setitem(sys.modules, "tensorboard", None)
    code, message = run_refused(capfd, *train_tiny, "--tensorboard", "--out", tmp_path / "out")
    assert code == 6
    assert "pip install 'duospacenet[tensorboard]'" in message
    assert not (tmp_path / "out").exists()


def test_a_resumed_training_continues_its_tensorboard_curves(train_watched, tmp_path, capfd):
    accumulator = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    out, options = tmp_path / "out", ["--tensorboard", "--save-every", "1", "--out", str(tmp_path / "out")]
    assert run_app([*train_watched, *options]) == 0
    assert run_app([*with_options(train_watched, "--steps", "6"), *options, "--resume"]) == 0
    curves = accumulator.EventAccumulator(str(out / "tensorboard"))
    curves.Reload()
    total, nds = (curves.Scalars(name) for name in ("loss/total", "validation/NDS"))
    logged = read_lines(out)
    assert [event.step for event in total] == list(range(6))
    assert [event.value for event in total] == pytest.approx([line["total"] for line in logged if "total" in line])
    assert [event.step for event in nds] == [2, 4, 6]


# --- Killed processes ---------------------------------------------------------------------------------------------


def test_a_training_that_is_killed_at_a_random_moment_resumes_to_the_same_result(train_watched, tmp_path, capfd):
    """SIGKILL, at most a second after the first batch. `test_validator.py` ends it at chosen moments."""
    command = [*with_options(train_watched, "--steps", "8"), "--save-every", "1"]
    assert run_app([*command, "--out", str(tmp_path / "whole")]) == 0
    out = tmp_path / "killed"
    process = start([*command, "--out", str(out)])
    try:
        wait_for(lambda: process.poll() is not None or (out / "log.jsonl").exists(), timeout_s=300)
        time.sleep(random.random())
    finally:
        process.kill()
        process.communicate(timeout=60)
    assert run_app([*command, "--out", str(out), "--resume"]) == 0
    assert reproducible_lines(out) == reproducible_lines(tmp_path / "whole")
    for name in ("weights.safetensors", "best.safetensors"):
        assert same_weights(out / name, tmp_path / "whole" / name), name


def test_ctrl_c_during_a_validation_ends_with_130_and_keeps_the_checkpoint(train_tiny, tmp_path):
    """The validation takes long, as its drive has 200 frames of full size."""
    out = tmp_path / "out"
    options = ["--validation", "synthetic:3:200", "--validate-every", "1", "--steps", "50", "--out", str(out)]
    process = start([*with_options(train_tiny, *options)], process_group=0)
    try:
        wait_for(lambda: process.poll() is not None or (out / "checkpoint.pt").exists(), timeout_s=300)
        os.killpg(process.pid, signal.SIGINT)
        _, message = process.communicate(timeout=300)
    except subprocess.TimeoutExpired:
        pytest.fail("the command did not end")
    finally:
        process.kill()
    assert process.returncode == 130, message
    assert "interrupted; finished results are on disk; add --resume to continue" in message.splitlines()
    assert "Traceback" not in message
    assert torch.load(out / "checkpoint.pt", weights_only=True)["step"] == 2
