"""Tests of the training folder: saving, resuming, and files it refuses."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from safetensors.torch import load_file

from duospacenet.model import DuoSpaceNet, DuoSpaceNetConfig
from duospacenet.runtime.errors import ArtifactError
from duospacenet.training.hash_trailer import append_hash
from duospacenet.weights import read_config
from tests.helpers.training_logs import reproducible_lines
from tests.helpers.trainings import (
    SIX_STEPS,
    TINY,
    continue_training,
    new_trainer,
    start_training_folder,
)

# --- Resuming -----------------------------------------------------------------------------------------------------


def test_resuming_cuts_the_log_back_to_the_checkpoint(two_clips, finished, tmp_path):
    folder = start_training_folder(tmp_path / "cut")
    steps = continue_training(folder, new_trainer(SIX_STEPS), two_clips)
    for _ in range(3):
        next(steps)
    steps.close()
    reached = torch.load(folder.path / "checkpoint.pt", weights_only=True)["step"]
    with (folder.path / "log.jsonl").open("a") as log:
        log.write('{"step": 77, "total": 1.0}\n{"step": 78, "to')
    folder.resume(new_trainer(SIX_STEPS))
    assert [line["step"] for line in folder.log.steps()] == list(range(reached)) == [0, 1]
    assert reproducible_lines(folder.path) == reproducible_lines(finished.path)[:2]


def test_a_training_without_a_checkpoint_resumes_from_the_start(tmp_path):
    folder = start_training_folder(tmp_path / "new")
    (folder.path / "log.jsonl").write_text('{"step": 0, "total": 1.0}\n')
    trainer = new_trainer(SIX_STEPS)
    folder.resume(trainer)
    assert trainer.step == 0
    assert folder.log.steps() == []


# --- The weights --------------------------------------------------------------------------------------------------


def test_the_weights_are_written_before_the_checkpoint(tmp_path, monkeypatch):
    """If a finished training had a checkpoint but no weights, resuming it would not write them."""
    folder = start_training_folder(tmp_path / "killed")
    monkeypatch.setattr(torch, "save", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        folder.save(new_trainer(SIX_STEPS))
    assert {path.name for path in folder.path.iterdir()} == {"training.json", "weights.safetensors"}


def test_tensorboard_events_are_on_disk_before_the_checkpoint(tmp_path, monkeypatch):
    """A training that resumes from the checkpoint never writes the events of earlier steps again."""
    folder, calls = start_training_folder(tmp_path / "out"), []
    folder.tensorboard = SimpleNamespace(flush=lambda: calls.append("flush"))
    save = torch.save
    monkeypatch.setattr(torch, "save", lambda *given: (calls.append("checkpoint"), save(*given)))
    folder.save(new_trainer(SIX_STEPS))
    assert calls == ["flush", "checkpoint"]


def test_the_weights_fit_the_model_and_equal_those_of_the_checkpoint(finished):
    tensors = load_file(finished.path / "weights.safetensors")
    DuoSpaceNet(TINY).load_state_dict(tensors, strict=True)
    state = torch.load(finished.path / "checkpoint.pt", weights_only=True)
    assert state["step"] == 6
    assert state["model"].keys() == tensors.keys()
    assert all(torch.equal(tensor, tensors[name]) for name, tensor in state["model"].items())


def test_the_weights_file_carries_the_configuration_of_the_model(tmp_path):
    """A model that is no preset: its configuration can be read back from the file alone."""
    config = replace(TINY, preset="mine", num_queries=40)
    folder = start_training_folder(tmp_path / "mine", config)
    folder.save(new_trainer(SIX_STEPS, config))
    stored = read_config(folder.path / "weights.safetensors")
    assert DuoSpaceNetConfig.from_dict(stored) == config
    DuoSpaceNet(DuoSpaceNetConfig.from_dict(stored)).load_state_dict(load_file(folder.path / "weights.safetensors"))


# --- Refused files ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("content", [b"", b"garbage", b"[1, 2]", b"3", b"\xff\xfe", b'{"settings": 3}'])
def test_an_invalid_record_is_refused(tmp_path, content):
    folder = start_training_folder(tmp_path / "folder")
    (folder.path / "training.json").write_bytes(content)
    with pytest.raises(ArtifactError, match=r"training\.json: expected the JSON object of a training run"):
        folder.read_record()


@pytest.mark.parametrize("content", ["garbage\n", "[1]\n", "{}\n", '{"step": "x"}\n', "3\n"])
def test_an_invalid_log_is_refused(tmp_path, content):
    folder = start_training_folder(tmp_path / "folder")
    (folder.path / "log.jsonl").write_text(content)
    with pytest.raises(ArtifactError, match=r"log\.jsonl: expected one JSON object per line"):
        folder.resume(new_trainer(SIX_STEPS))


def write_invalid_checkpoints(folder):
    """Write files that are not a training state. The name says what is wrong."""
    state = new_trainer(SIX_STEPS).state_dict()
    del state["model"]["queries.pose"]
    for name, content in (("missing-tensor", state), ("list", [1, 2]), ("empty-dict", {})):
        torch.save(content, folder / name)
        append_hash(folder / name)
    torch.save(new_trainer(SIX_STEPS).state_dict(), folder / "no-hash")
    (folder / "garbage").write_bytes(b"\x80\x02garbage")
    (folder / "empty-file").write_bytes(b"")


@pytest.mark.parametrize("name", ["missing-tensor", "list", "empty-dict", "garbage", "empty-file", "no-hash"])
def test_an_invalid_checkpoint_is_refused(tmp_path, name):
    write_invalid_checkpoints(tmp_path)
    folder = start_training_folder(tmp_path / "folder")
    (tmp_path / name).rename(folder.path / "checkpoint.pt")
    with pytest.raises(ArtifactError, match=r"checkpoint\.pt: expected the state of this training run; got "):
        folder.resume(new_trainer(SIX_STEPS))


def test_code_in_a_checkpoint_is_not_run(tmp_path):
    class Harmful:
        def __reduce__(self):
            return (Path.touch, (tmp_path / "harm",))

    folder = start_training_folder(tmp_path / "folder")
    torch.save(Harmful(), folder.path / "checkpoint.pt")
    append_hash(folder.path / "checkpoint.pt")
    with pytest.raises(ArtifactError, match=r"checkpoint\.pt: expected the state"):
        folder.resume(new_trainer(SIX_STEPS))
    assert not (tmp_path / "harm").exists()
