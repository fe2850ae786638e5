"""`duospacenet train` from end to end: the files that it writes, and the weights that it starts from."""

import json
import re
from dataclasses import replace

import pytest
import torch
from safetensors.torch import load_file, save_file

from duospacenet.cli.main import run_app
from duospacenet.jobs.config_file import config_to_json
from duospacenet.jobs.models import load_starting_weights
from duospacenet.jobs.training import initial_model
from duospacenet.model import DuoSpaceNet, randomise
from duospacenet.training.samples import synthetic_clips
from duospacenet.weights.provenance import hash_weights
from tests.helpers.train_command import TRAIN_TINY, with_options
from tests.helpers.trainings import TINY, synthetic_frames

FILES = {"training.json", "checkpoint.pt", "log.jsonl", "weights.safetensors", "losses.png"}


def test_a_training_writes_its_folder_and_prints_a_summary(train_tiny, tmp_path, capfd):
    assert run_app([*train_tiny, "--out", str(tmp_path / "new" / "out"), "--json"]) == 0
    printed = capfd.readouterr()
    out = tmp_path / "new" / "out"
    assert {path.name for path in out.iterdir()} == FILES
    log = [json.loads(line) for line in (out / "log.jsonl").read_text().splitlines()]
    assert [line["step"] for line in log] == [0, 1, 2, 3]
    summary = json.loads(printed.out)
    assert summary["weights"] == str(out / "weights.safetensors")
    assert summary["steps"] == 4
    assert summary["loss"] == pytest.approx(sum(line["total"] for line in log) / 4)
    assert json.loads((out / "training.json").read_text())["settings"]["amp"] == "off"


def test_a_training_starts_from_the_weights_of_a_pretraining(train_tiny, training_scene, tmp_path, capfd):
    """The weights of the pretraining are complete, and the record of the training holds their hash."""
    first, second = tmp_path / "first", tmp_path / "second"
    assert run_app([*train_tiny, "--pretraining", "--out", str(first)]) == 0
    weights = first / "weights.safetensors"
    options = ["--source", str(training_scene), "--weights", str(weights), "--seed", "1", "--steps", "2"]
    again = with_options(TRAIN_TINY, *options)
    assert run_app([*again, "--out", str(second)]) == 0
    model = DuoSpaceNet(TINY)
    model.load_state_dict(load_file(weights))
    assert json.loads((second / "training.json").read_text())["start"] == hash_weights(model)
    assert "internal error" not in capfd.readouterr().err


def test_by_default_random_weights_are_trained_on_synthetic_scenes(tmp_path, monkeypatch, capfd):
    """The queries start at anchors from the first frames; here from fewer frames than in a real training."""
    monkeypatch.setattr(synthetic_clips, "ANCHOR_FRAMES", 4)
    assert run_app(with_options(TRAIN_TINY, "--steps", "1", "--out", str(tmp_path / "out"))) == 0
    assert "wrote" in capfd.readouterr().out
    record = json.loads((tmp_path / "out" / "training.json").read_text())
    assert re.fullmatch(r"synthetic world \d+, clips of 2 frames from seed 1000000000000000000", record["data"])
    DuoSpaceNet(TINY).load_state_dict(load_file(tmp_path / "out" / "weights.safetensors"))


def test_missing_tensors_are_initialised_and_queries_start_among_the_objects(training_scene, tmp_path, capfd):
    """The checkpoint only holds an image encoder. The learning rate is too small to change it visibly."""
    encoder = randomise(DuoSpaceNet(TINY), 5).image_encoder.state_dict()
    save_file({f"image_encoder.{name}": tensor for name, tensor in encoder.items()}, tmp_path / "encoder.safetensors")
    weights = str(tmp_path / "encoder.safetensors")
    begin = with_options(TRAIN_TINY, "--source", str(training_scene), "--weights", weights, "--steps", "1")
    assert run_app([*begin, "--out", str(tmp_path / "refused")]) == 4
    assert not (tmp_path / "refused").exists()
    allowed = ["--allow-missing", "*", "--learning-rate", "1e-12", "--out", str(tmp_path / "out")]
    capfd.readouterr()
    assert run_app([*begin, *allowed]) == 0
    assert re.search(r"encoder\.safetensors: \d+ tensors matched, \d+ allowed to be missing", capfd.readouterr().err)
    learned = load_file(tmp_path / "out" / "weights.safetensors")
    for name, _ in DuoSpaceNet(TINY).image_encoder.named_parameters():
        torch.testing.assert_close(learned[f"image_encoder.{name}"], encoder[name], msg=name)
    centres = torch.cat([torch.from_numpy(frame.ground_truth.boxes[:, :3]) for frame in synthetic_frames(1, 3)]).float()
    positions = learned["queries.pose"][:, :3]
    assert (positions >= centres.amin(dim=0) - 1e-3).all()
    assert (positions <= centres.amax(dim=0) + 1e-3).all()
    assert positions[:, 2].std() > 0.1  # without anchors, all queries start one metre above the ground
    assert run_app([*begin, *allowed, "--resume"]) == 0  # the initialisation is repeatable: the record holds its hash


def test_notes_on_the_checkpoint_are_printed(train_tiny, tmp_path, capfd, monkeypatch):
    """For example, names cannot tell how a torchvision ResNet was trained."""
    note = "how it was trained is assumed"
    monkeypatch.setattr(
        initial_model,
        "load_starting_weights",
        lambda *given, **chosen: load_starting_weights(*given, **chosen).with_notes([note]),
    )
    assert run_app([*train_tiny, "--out", str(tmp_path / "out")]) == 0
    assert f"note: {note}" in capfd.readouterr().err.splitlines()


def test_a_training_with_a_configuration_file_is_exported_without_naming_the_configuration(
    training_scene, tmp_path, capfd
):
    """The weights carry the configuration, which is not a preset."""
    config = replace(TINY, preset="mine", num_queries=24)
    (tmp_path / "mine.json").write_text(config_to_json(config))
    train = [argument if argument != "tiny" else str(tmp_path / "mine.json") for argument in TRAIN_TINY]
    train[train.index("--preset")] = "--config"
    train = with_options(train, "--source", str(training_scene), "--steps", "1", "--out", str(tmp_path / "out"))
    assert run_app(train) == 0
    weights = ["--weights", str(tmp_path / "out" / "weights.safetensors"), "--dry-run"]
    assert run_app(["export", *weights]) == 0
    assert "accepted" in capfd.readouterr().out
    assert run_app(["export", "--preset", "tiny", *weights]) == 4  # another number of queries
