"""A training in its folder: broken off and gone on with it is the same training, and its weights say what they are."""

import json
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file

from duospacenet.model import DuoSpaceNet
from duospacenet.runtime.errors import ArtifactError, UsageError
from duospacenet.training import TrainingFolder, TrainingRecord, train
from duospacenet.training.clip_loader import load_clips, remaining_clips
from duospacenet.training.loss_curves import write_loss_curves
from duospacenet.weights.input_contract import preprocessing
from tests.helpers.trainings import TINY, FixedClips, new_trainer, settings_with, synthetic_frames

SETTINGS = settings_with(steps=6, auxiliary_matches=2, grid_mask=0.5)


@pytest.fixture(scope="module")
def drives():
    """Drives of two frames; one of another scene is shorter, so that the groups take 2, 1, 2 and 1 steps."""
    return FixedClips((synthetic_frames(1, 2), synthetic_frames(2, 1)))


def training_of(settings=SETTINGS):
    return TrainingRecord("tiny", settings, "given frames", "as drawn")


def go_on(folder, trainer, drives, save_every=1):
    """Resume, train to the end; returns the steps."""
    folder.resume(trainer)
    numbers = remaining_clips(drives, trainer.settings, trainer.step)
    samples = load_clips(drives, TINY, preprocessing(TINY), numbers, workers=0)
    return train(trainer, folder, samples, save_every)


def begun(path: Path) -> TrainingFolder:
    path.mkdir()
    folder = TrainingFolder(path, training_of())
    folder.write_record()
    return folder


@pytest.fixture(scope="module")
def whole(drives, tmp_path_factory):
    """A training from its first step to its last."""
    folder = begun(tmp_path_factory.mktemp("training") / "whole")
    assert [step.number for step in go_on(folder, new_trainer(SETTINGS), drives)] == list(range(6))
    return folder


@pytest.mark.parametrize("broken_off_after", [1, 2, 3, 4])
def test_a_training_that_is_resumed_is_the_one_that_never_broke_off(drives, whole, tmp_path, broken_off_after):
    """Whether a step, a group or a checkpoint was the last: bit for bit, and line for line in the log."""
    folder = begun(tmp_path / "resumed")
    steps = go_on(folder, new_trainer(SETTINGS), drives)
    for _ in range(broken_off_after):
        next(steps)
    steps.close()
    again = TrainingFolder(folder.path, training_of())
    again.check_record()
    rest = list(go_on(again, new_trainer(SETTINGS), drives))
    assert 6 - broken_off_after <= len(rest) <= 6
    ours, expected = (load_file(one.path / "weights.safetensors") for one in (again, whole))
    assert [name for name, tensor in expected.items() if not torch.equal(tensor, ours[name])] == []
    assert (again.path / "log.jsonl").read_text() == (whole.path / "log.jsonl").read_text()


def test_the_log_has_a_line_a_step_with_every_loss(whole):
    lines = [json.loads(line) for line in (whole.path / "log.jsonl").read_text().splitlines()]
    assert [line["step"] for line in lines] == list(range(6))
    assert all(line.keys() == lines[0].keys() for line in lines)
    assert {"gradient_norm", "total", "class_0", "box_1", "dice_lane_boundary", "heatmap_bev"} <= lines[0].keys()


def test_the_log_is_cut_back_to_the_checkpoint(drives, whole, tmp_path):
    folder = begun(tmp_path / "cut")
    steps = go_on(folder, new_trainer(SETTINGS), drives)
    for _ in range(3):
        next(steps)
    steps.close()
    reached = torch.load(folder.path / "checkpoint.pt", weights_only=True)["step"]
    with (folder.path / "log.jsonl").open("a") as log:
        log.write('{"step": 77, "total": 1.0}\n{"step": 78, "to')
    folder.resume(new_trainer(SETTINGS))
    assert [line["step"] for line in folder.read_log()] == list(range(reached)) == [0, 1]
    assert (whole.path / "log.jsonl").read_text().startswith((folder.path / "log.jsonl").read_text())


def test_without_a_checkpoint_a_resumed_training_begins_anew(tmp_path):
    folder = begun(tmp_path / "new")
    (folder.path / "log.jsonl").write_text('{"step": 0, "total": 1.0}\n')
    trainer = new_trainer(SETTINGS)
    folder.resume(trainer)
    assert trainer.step == 0
    assert folder.read_log() == []


def test_the_state_is_saved_after_so_many_steps_and_at_the_end(drives, tmp_path, monkeypatch):
    saved = []
    monkeypatch.setattr(TrainingFolder, "save", lambda _, trainer: saved.append(trainer.step))
    list(go_on(begun(tmp_path / "often"), new_trainer(SETTINGS), drives, save_every=3))
    assert saved == [3, 6]
    saved.clear()
    list(go_on(begun(tmp_path / "seldom"), new_trainer(SETTINGS), drives, save_every=100))
    assert saved == [6]


def test_weights_are_on_the_disk_before_the_state_that_says_they_are(tmp_path, monkeypatch):
    """Killed between the two, a finished training would be resumed without anything left to write."""
    folder = begun(tmp_path / "killed")
    monkeypatch.setattr(torch, "save", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        folder.save(new_trainer(SETTINGS))
    assert {path.name for path in folder.path.iterdir()} == {"training.json", "weights.safetensors"}


# --- The weights --------------------------------------------------------------------------------------------------


def test_the_weights_fit_the_model_and_are_those_of_the_last_step(whole):
    tensors = load_file(whole.path / "weights.safetensors")
    DuoSpaceNet(TINY).load_state_dict(tensors, strict=True)
    state = torch.load(whole.path / "checkpoint.pt", weights_only=True)
    assert state["step"] == 6
    assert state["model"].keys() == tensors.keys()
    assert all(torch.equal(tensor, tensors[name]) for name, tensor in state["model"].items())


def test_the_weights_say_where_they_come_from(whole):
    with safe_open(whole.path / "weights.safetensors", "pt") as file:
        said = file.metadata()
    expected = {"trained": "true", "preset": "tiny", "step": "6", "steps": "6", "seed": "0", "data": "given frames"}
    assert expected.items() <= said.items()
    assert said["start"] == "as drawn"
    assert json.loads(said["settings"])["grid_mask"] == 0.5
    root = Path(__file__).parents[2]
    asked = subprocess.run(["git", "rev-parse", "HEAD"], cwd=root, capture_output=True, text=True, check=False)
    assert said["commit"] == (asked.stdout.strip() if (root / ".git").exists() else "unknown")


def test_weights_of_which_but_a_part_has_learned_say_so():
    assert training_of(replace(SETTINGS, pretraining=True)).metadata(6)["trained"] == "false"


# --- What does not belong -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("other", "words"),
    [
        (training_of(replace(SETTINGS, learning_rate=1e-3)), "learning_rate 0.0002; got 0.001"),
        (training_of(replace(SETTINGS, pv_supervision=False)), "pv_supervision True; got False"),
        (replace(training_of(), preset="nano"), "preset 'tiny'; got 'nano'"),
        (replace(training_of(), data="others"), "data 'given frames'; got 'others'"),
        (replace(training_of(), start="0123"), "start 'as drawn'; got '0123'"),
    ],
)
def test_another_training_is_not_gone_on_with(tmp_path, other, words):
    folder = begun(tmp_path / "folder")
    folder.check_record()
    with pytest.raises(UsageError, match=words):
        TrainingFolder(folder.path, other).check_record()


@pytest.mark.parametrize("content", [b"", b"garbage", b"[1, 2]", b"3", b"\xff\xfe", b'{"settings": 3}'])
def test_a_record_that_cannot_be_read_is_refused(tmp_path, content):
    folder = begun(tmp_path / "folder")
    (folder.path / "training.json").write_bytes(content)
    with pytest.raises(ArtifactError, match=r"training\.json: expected the JSON object of a training"):
        folder.check_record()


@pytest.mark.parametrize("content", ["garbage\n", "[1]\n", "{}\n", '{"step": "x"}\n', "3\n"])
def test_a_log_that_cannot_be_read_is_refused(tmp_path, content):
    folder = begun(tmp_path / "folder")
    (folder.path / "log.jsonl").write_text(content)
    with pytest.raises(ArtifactError, match=r"log\.jsonl: expected one JSON object per line"):
        folder.resume(new_trainer(SETTINGS))


def states(tmp_path):
    """Files that are no state of a training, by what is wrong with them."""
    state = new_trainer(SETTINGS).state_dict()
    del state["model"]["queries.pose"]
    for name, content in (("lacking", state), ("list", [1, 2]), ("empty", {})):
        torch.save(content, tmp_path / name)
    (tmp_path / "garbage").write_bytes(b"\x80\x02garbage")
    (tmp_path / "nothing").write_bytes(b"")


@pytest.mark.parametrize("name", ["lacking", "list", "empty", "garbage", "nothing"])
def test_a_checkpoint_that_is_none_is_refused(tmp_path, name):
    states(tmp_path)
    folder = begun(tmp_path / "folder")
    (tmp_path / name).rename(folder.path / "checkpoint.pt")
    with pytest.raises(ArtifactError, match=r"checkpoint\.pt: expected the state of this training; got "):
        folder.resume(new_trainer(SETTINGS))


def test_a_checkpoint_that_would_run_code_is_not_run(tmp_path):
    class Harmful:
        def __reduce__(self):
            return (Path.touch, (tmp_path / "harm",))

    folder = begun(tmp_path / "folder")
    torch.save(Harmful(), folder.path / "checkpoint.pt")
    with pytest.raises(ArtifactError, match=r"checkpoint\.pt: expected the state"):
        folder.resume(new_trainer(SETTINGS))
    assert not (tmp_path / "harm").exists()


# --- Curves -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("num_steps", [0, 1, 3, 300])
def test_curves_are_drawn_of_any_number_of_steps(tmp_path, num_steps):
    log = [{"step": step, "gradient_norm": 1.0, "class_0": 2.0 / (step + 1), "total": 3.0} for step in range(num_steps)]
    write_loss_curves(log, tmp_path / "losses.png")
    assert (tmp_path / "losses.png").read_bytes().startswith(b"\x89PNG")
