"""Tests of the validator: it leaves the training unchanged, keeps the best weights, and can be interrupted."""

import json
from itertools import pairwise

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file

from duospacenet.evaluation import evaluate
from duospacenet.training.activation_checkpointing import checkpoint_activations
from duospacenet.training.samples.batches import make_batches
from duospacenet.training.samples.clip_loader import load_clips, remaining_clips
from duospacenet.training.training_loop import train
from duospacenet.training.watching.validation_schedule import ValidationSchedule
from duospacenet.training.watching.validation_scores import ValidationScores
from duospacenet.training.watching.validator import Validator
from duospacenet.weights.input_contract import preprocessing
from tests.helpers.training_logs import read_lines, reproducible_lines
from tests.helpers.trainings import SIX_STEPS, TINY, new_trainer, settings_with, start_training_folder
from tests.training.watching.test_validation_scores import sample_of


class Judge:
    """An `evaluate` that gives the weights of successive validations chosen map IoUs. It keeps the models."""

    def __init__(self, *ious):
        self.models, self._ious = [], list(ious)

    def __call__(self, model):
        self.models.append(model)
        torch.rand(3)  # no validation does this; the training must not depend on it all the same
        iou = self._ious.pop(0)
        return evaluate([sample_of([], [[1] * iou + [0] * (10 - iou)], [[1] * 10], has_boxes=False)])


def validator_of(folder, judge, every=2, reported=None):
    schedule = ValidationSchedule(every, "drives", folder.read_validations())
    report = (lambda scores, is_best: reported.append((scores.step, is_best))) if reported is not None else None
    return Validator(judge, "drives", schedule, *([report] if report else []))


def continue_with(folder, trainer, clips, judge, every=2, reported=None, save_every=100):
    """Resume from the folder and train to the end, with validation."""
    folder.resume(trainer)
    validator = None if judge is None else validator_of(folder, judge, every, reported)
    numbers = remaining_clips(clips, trainer.settings, trainer.step)
    loaded = load_clips(clips, TINY, preprocessing(TINY), numbers, 0, trainer.settings)
    batches = make_batches(loaded, clips, numbers, trainer.settings)
    return train(trainer, folder, batches, save_every, validator)


@pytest.fixture(scope="module")
def improving(two_clips, tmp_path_factory):
    """The folder of a training with three validations, each better than the last, and what was reported."""
    folder, reported = start_training_folder(tmp_path_factory.mktemp("validated") / "out"), []
    list(continue_with(folder, new_trainer(SIX_STEPS), two_clips, Judge(3, 4, 5), reported=reported))
    return folder, reported


def same_tensors(first, second):
    first, second = (load_file(path) for path in (first, second))
    return first.keys() == second.keys() and all(torch.equal(tensor, second[name]) for name, tensor in first.items())


def test_a_training_with_validation_gives_the_same_weights_and_losses(improving, finished):
    """Batches take 2, 1, 2 and 1 steps, so the training is validated after steps 2, 5 and 6."""
    folder, reported = improving
    assert same_tensors(folder.path / "weights.safetensors", finished.path / "weights.safetensors")
    ours, expected = ([without_epoch(line) for line in reproducible_lines(one.path)] for one in (folder, finished))
    assert [line for line in ours if "validation" not in line] == expected
    assert reported == [(2, True), (5, True), (6, True)]


def without_epoch(line):
    return {name: value for name, value in line.items() if name != "epoch"}


def test_a_validation_gets_a_copy_of_the_model_in_evaluation_mode(two_clips, tmp_path):
    folder, trainer, judge = start_training_folder(tmp_path / "out"), new_trainer(SIX_STEPS), Judge(1, 2, 3)
    reports = continue_with(folder, trainer, two_clips, judge)
    for _ in range(3):
        next(reports)  # the third step comes after the first validation
    (model,) = judge.models
    assert not any(module.training for module in model.modules())
    assert trainer.model.training
    own = {tensor.data_ptr() for tensor in trainer.model.state_dict().values()}
    assert own.isdisjoint(tensor.data_ptr() for tensor in model.state_dict().values())
    assert all(torch.isfinite(tensor).all() for tensor in model.state_dict().values())


def test_the_copy_of_a_model_with_checkpointed_activations_computes_with_its_own_modules(two_clips, tmp_path):
    folder, trainer, judge = start_training_folder(tmp_path / "out"), new_trainer(settings_with(steps=1)), Judge(1)
    checkpoint_activations(trainer.model)
    list(continue_with(folder, trainer, two_clips, judge))
    wrapped = [module for module in judge.models[0].modules() if "forward" in vars(module)]
    assert wrapped
    assert all(module.forward.args[0].__self__ is module for module in wrapped)


def test_the_averaged_weights_are_validated_and_kept(two_clips, tmp_path):
    settings = settings_with(steps=2, ema_decay=0.9)
    folder, trainer, judge = start_training_folder(tmp_path / "out"), new_trainer(settings), Judge(5)
    list(continue_with(folder, trainer, two_clips, judge))
    average, best = trainer.evaluated_model.state_dict(), load_file(folder.path / "best.safetensors")
    for name, tensor in judge.models[0].state_dict().items():
        assert torch.equal(tensor, average[name]), name
        assert torch.equal(tensor, best[name]), name
    current = trainer.model.state_dict()
    assert any(not torch.equal(current[name], tensor) for name, tensor in average.items())


def test_the_best_weights_and_the_last_weights_are_kept_with_their_provenance(two_clips, tmp_path):
    folder = start_training_folder(tmp_path / "out")
    list(continue_with(folder, new_trainer(SIX_STEPS), two_clips, Judge(3, 5, 4)))
    with (
        safe_open(folder.path / "best.safetensors", "pt") as best,
        safe_open(folder.path / "weights.safetensors", "pt") as last,
    ):
        best_metadata, last_metadata = best.metadata(), last.metadata()
    assert (best_metadata["step"], last_metadata["step"]) == ("5", "6")
    validation = json.loads(best_metadata["validation"])
    assert (validation["best_by"], validation["map_iou"], validation["data"]) == (
        "mean map IoU",
        {"drivable_area": 0.5},
        "drives",
    )
    assert "validation" not in last_metadata
    assert best_metadata["settings"] == last_metadata["settings"]
    assert not same_tensors(folder.path / "best.safetensors", folder.path / "weights.safetensors")
    lines = [line for line in read_lines(folder.path) if "validation" in line]
    assert [line["step"] for line in lines] == [2, 5, 6]
    assert [line["validation"]["map_iou"]["drivable_area"] for line in lines] == pytest.approx([0.3, 0.5, 0.4])


def test_a_checkpoint_is_saved_before_each_validation(two_clips, tmp_path):
    folder, saved = start_training_folder(tmp_path / "out"), []

    def judge(model):
        saved.append(torch.load(folder.path / "checkpoint.pt", weights_only=True)["step"])
        return Judge(1)(model)

    list(continue_with(folder, new_trainer(SIX_STEPS), two_clips, judge))
    assert saved == [2, 5, 6]


class Killed(BaseException):
    """Ends the training at once, as a killed process does."""


def kill(folder, place, monkeypatch, judge):
    """End the second validation at a place of it. Returns the judge to use."""
    calls = {"number": 0}

    def counted(function):
        def wrapper(*arguments):
            calls["number"] += 1
            if calls["number"] == 2:
                raise Killed
            return function(*arguments)

        return wrapper

    if place == "evaluation":
        return counted(judge)
    monkeypatch.setattr(folder, place, counted(getattr(folder, place)))
    return judge


@pytest.mark.parametrize("place", ["evaluation", "save_best", "append_validation", "save"])
def test_a_training_that_is_killed_at_a_validation_resumes_to_the_same_result(
    two_clips, improving, tmp_path, monkeypatch, place
):
    """Every validation is better than the last, so that `save_best` is called in each."""
    whole, _ = improving
    folder = start_training_folder(tmp_path / "killed")
    judge = kill(folder, place, monkeypatch, Judge(3, 4, 5))
    with pytest.raises(Killed):
        list(continue_with(folder, new_trainer(SIX_STEPS), two_clips, judge))
    monkeypatch.undo()
    list(continue_with(folder, new_trainer(SIX_STEPS), two_clips, Judge(4, 5)))
    for name in ("weights.safetensors", "best.safetensors"):
        assert same_tensors(folder.path / name, whole.path / name), name
    assert reproducible_lines(folder.path) == reproducible_lines(whole.path)


def test_the_best_of_an_interrupted_training_stays_the_best(two_clips, tmp_path):
    folder, reported = start_training_folder(tmp_path / "out"), []
    reports = continue_with(folder, new_trainer(SIX_STEPS), two_clips, Judge(9))
    for _ in range(3):
        next(reports)
    reports.close()
    before = (folder.path / "best.safetensors").read_bytes()
    list(continue_with(folder, new_trainer(SIX_STEPS), two_clips, Judge(5, 6), reported=reported))
    assert reported == [(5, False), (6, False)]
    assert (folder.path / "best.safetensors").read_bytes() == before


def test_scores_in_the_log_are_in_the_order_of_the_steps(improving):
    lines = read_lines(improving[0].path)
    completed = [line["step"] + ("validation" not in line) for line in lines]
    assert all(before <= after for before, after in pairwise(completed))
    assert [ValidationScores.from_dict(line).step for line in lines if "validation" in line] == [2, 5, 6]
