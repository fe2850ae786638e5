"""Tests of the training loop: when it saves, and that a resumed run equals an uninterrupted one."""

import pytest
import torch
from safetensors.torch import load_file

from duospacenet.training import TrainingFolder
from duospacenet.training.training_record import flatten_record
from tests.helpers.training_logs import read_lines, reproducible_lines
from tests.helpers.trainings import (
    SIX_STEPS,
    continue_training,
    new_trainer,
    record_with,
    start_training_folder,
)


@pytest.mark.parametrize("interrupted_after", [1, 2, 3, 4])
def test_a_resumed_run_equals_an_uninterrupted_run(two_clips, finished, tmp_path, interrupted_after):
    """After an interruption within a batch, between batches, or right after a checkpoint: equal weights and logs."""
    folder = start_training_folder(tmp_path / "resumed")
    steps = continue_training(folder, new_trainer(SIX_STEPS), two_clips)
    for _ in range(interrupted_after):
        next(steps)
    steps.close()
    again = TrainingFolder(folder.path, record_with())
    assert again.read_record() == flatten_record(record_with().to_dict())
    rest = list(continue_training(again, new_trainer(SIX_STEPS), two_clips))
    assert 6 - interrupted_after <= len(rest) <= 6
    ours, expected = (load_file(one.path / "weights.safetensors") for one in (again, finished))
    assert [name for name, tensor in expected.items() if not torch.equal(tensor, ours[name])] == []
    assert reproducible_lines(again.path) == reproducible_lines(finished.path)


def test_the_log_has_one_line_per_step_with_every_loss(finished):
    lines = read_lines(finished.path)
    assert [line["step"] for line in lines] == list(range(6))
    assert all(line.keys() == lines[0].keys() for line in lines)
    assert {"gradient_norm", "total", "class_0", "box_1", "dice_lane_boundary", "heatmap_bev"} <= lines[0].keys()


def test_a_checkpoint_is_saved_after_the_given_number_of_steps_and_at_the_end(two_clips, tmp_path, monkeypatch):
    saved = []
    monkeypatch.setattr(TrainingFolder, "save", lambda _, trainer: saved.append(trainer.step))
    list(continue_training(start_training_folder(tmp_path / "often"), new_trainer(SIX_STEPS), two_clips, save_every=3))
    assert saved == [3, 6]
    saved.clear()
    rarely = start_training_folder(tmp_path / "rarely")
    list(continue_training(rarely, new_trainer(SIX_STEPS), two_clips, save_every=100))
    assert saved == [6]
