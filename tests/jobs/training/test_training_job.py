"""The job that trains in a folder: its settings, its results and its messages."""

from collections import Counter
from dataclasses import replace

import pytest
import torch
from safetensors import safe_open

from duospacenet.cli.main import run_app
from duospacenet.data.scene_writer import write_scene
from duospacenet.jobs.training.requested_settings import training_settings
from duospacenet.jobs.training.training_job import train_model
from duospacenet.model import DuoSpaceNet, randomise
from duospacenet.runtime.errors import UsageError
from duospacenet.weights import save_checkpoint
from tests.helpers.train_command import TRAIN_TINY, with_options
from tests.helpers.training_logs import reproducible_lines
from tests.helpers.trainings import TINY, synthetic_frames


def test_the_backbone_has_the_same_learning_rate_unless_another_is_given():
    values = {"steps": 1, "learning_rate": 1e-3, "backbone_learning_rate": None}
    assert training_settings(values).backbone_learning_rate == 1e-3
    assert training_settings(values | {"backbone_learning_rate": 1e-4}).backbone_learning_rate == 1e-4


def test_an_invalid_setting_is_refused_with_the_name_of_its_option():
    values = {"steps": 1, "learning_rate": 0, "backbone_learning_rate": None}
    with pytest.raises(UsageError, match=r"--learning-rate: Input should be greater than 0; got 0\.$"):
        training_settings(values)


def test_the_job_trains_the_same_weights_as_the_command(tmp_path, capfd):
    save_checkpoint(tmp_path / "tiny.safetensors", randomise(DuoSpaceNet(TINY), 0))
    values = {"steps": 1, "batch_size": 1, "frames_per_clip": 2, "warmup_steps": 1, "amp": "off"}
    rates = {"learning_rate": 4e-4, "backbone_learning_rate": None, "auxiliary_matches": 3}
    messages = []
    summary = train_model(
        TINY,
        training_settings(values | rates),
        tmp_path / "job",
        sources="synthetic:1:2",
        weights=tmp_path / "tiny.safetensors",
        workers=0,
        notify=messages.append,
    )
    printed = capfd.readouterr()
    assert printed.out == printed.err == ""
    assert any("tensors matched" in message for message in messages)
    assert summary.weights == tmp_path / "job" / "weights.safetensors"
    command = with_options(TRAIN_TINY, "--steps", "1", "--source", "synthetic:1:2", "--out", str(tmp_path / "command"))
    assert run_app([*command, "--weights", str(tmp_path / "tiny.safetensors")]) == 0
    assert (tmp_path / "job" / "training.json").read_bytes() == (tmp_path / "command" / "training.json").read_bytes()
    assert reproducible_lines(tmp_path / "job") == reproducible_lines(tmp_path / "command")
    with (
        safe_open(tmp_path / "job" / "weights.safetensors", "pt") as from_job,
        safe_open(tmp_path / "command" / "weights.safetensors", "pt") as from_command,
    ):
        assert from_job.metadata() == from_command.metadata()  # safetensors writes it in a random order
        assert set(from_job.keys()) == set(from_command.keys())
        for name in from_job.keys():  # noqa: SIM118, the file is not a dictionary
            assert torch.equal(from_job.get_tensor(name), from_command.get_tensor(name)), name


def test_mapped_and_left_out_boxes_are_counted_before_the_first_step(tmp_path):
    names = {"car": "vehicle.car", "barrier": "animal"}
    frames = [
        replace(frame, ground_truth=replace(truth, classes=tuple(names.get(name, name) for name in truth.classes)))
        for frame in synthetic_frames(1, 2)
        if (truth := frame.ground_truth)
    ]
    write_scene(tmp_path / "scene", frames)
    counts = Counter(name for frame in frames for name in frame.ground_truth.classes)
    values = {"steps": 1, "batch_size": 1, "frames_per_clip": 2, "warmup_steps": 1, "amp": "off"}
    settings = training_settings(values | {"learning_rate": 4e-4, "backbone_learning_rate": None})
    messages = []

    def first_step(*_, **__):
        messages.append("first step")
        return iter(())

    train_model(
        TINY,
        settings,
        tmp_path / "out",
        sources=tmp_path / "scene",
        workers=0,
        notify=messages.append,
        step_progress=first_step,
    )
    until_first_step = messages[: messages.index("first step")]
    num_cars = counts["vehicle.car"]
    assert f"ground truth: mapped {num_cars} boxes to classes: vehicle.car -> car ({num_cars})" in until_first_step
    assert f"ground truth: left out {counts['animal']} boxes of other classes: animal ({counts['animal']})" in messages
    used = counts.total() - counts["animal"]
    assert f"ground truth: {used} boxes in 2 frames to train on" in until_first_step
