"""The start of a training in a folder: the record of a new one, and what may differ when one is resumed."""

import json
from dataclasses import replace

import pytest

from duospacenet.jobs.training.training_start import begin_or_resume, check_training_folder, read_extensions
from duospacenet.runtime.errors import ArtifactError, OutputError, UsageError
from duospacenet.training import TrainingFolder
from duospacenet.training.optimisation import learning_rate_factor
from duospacenet.training.training_record import Extension
from tests.helpers.training_logs import read_lines, reproducible_lines
from tests.helpers.trainings import (
    SIX_STEPS,
    TINY,
    FixedClips,
    continue_training,
    new_trainer,
    record_with,
    start_training_folder,
    synthetic_frames,
)

EIGHT_STEPS = replace(SIX_STEPS, steps=8)


@pytest.fixture(scope="module")
def two_clips():
    """Clips of two frames and of one frame from another scene: batches of one take 2, 1, 2 and 1 steps."""
    return FixedClips((synthetic_frames(1, 2), synthetic_frames(2, 1)))


def resume(path, settings, notify=lambda message: None):
    """Resume the training in a folder with these settings. Returns the folder and the trainer."""
    folder, trainer = TrainingFolder(path, record_with(settings)), new_trainer(settings)
    begin_or_resume(folder, trainer, resume=True, notify=notify)
    return folder, trainer


def test_a_training_is_extended_to_more_steps(two_clips, tmp_path):
    """Batches take 2, 1, 2, 1, ... steps. The training is interrupted after two steps, and extended from 6 to 8."""
    folder = start_training_folder(tmp_path / "out")
    reports = continue_training(folder, new_trainer(SIX_STEPS), two_clips)
    for _ in range(3):
        next(reports)
    reports.close()
    messages = []
    folder, trainer = resume(folder.path, EIGHT_STEPS, messages.append)
    assert trainer.step == 2
    assert messages == [
        "the training is extended from 6 to 8 steps; after step 2, the learning rate follows the schedule of 8 steps"
    ]
    list(continue_training(folder, trainer, two_clips))
    record = json.loads((folder.path / "training.json").read_text())
    assert record["settings"]["steps"] == 8
    assert record["extended"] == [{"at_step": 2, "old_steps": 6, "new_steps": 8}]
    peak = SIX_STEPS.learning_rate
    rates = [line["learning_rate"] for line in read_lines(folder.path)]
    expected = [peak * learning_rate_factor(step, SIX_STEPS if step < 2 else EIGHT_STEPS) for step in range(8)]
    assert rates == pytest.approx(expected)
    assert folder.record.metadata(8)["steps"] == "8"
    assert json.loads(folder.record.metadata(8)["extended"]) == record["extended"]


def test_a_finished_training_is_extended_and_the_earlier_steps_stay_in_the_log(two_clips, tmp_path):
    folder = start_training_folder(tmp_path / "out")
    list(continue_training(folder, new_trainer(SIX_STEPS), two_clips))
    before = reproducible_lines(folder.path)
    folder, trainer = resume(folder.path, EIGHT_STEPS)
    assert len(list(continue_training(folder, trainer, two_clips))) == 2
    assert reproducible_lines(folder.path)[:6] == before
    assert [line["step"] for line in read_lines(folder.path)] == list(range(8))


def test_an_extended_training_is_resumed_with_its_new_steps_and_extended_again(tmp_path):
    folder = start_training_folder(tmp_path / "out")
    resume(folder.path, EIGHT_STEPS)
    messages = []
    again, _ = resume(folder.path, EIGHT_STEPS, messages.append)
    assert (messages, again.record.extended) == ([], (Extension(0, 6, 8),))
    third, _ = resume(folder.path, replace(SIX_STEPS, steps=9))
    assert third.record.extended == (Extension(0, 6, 8), Extension(0, 8, 9))
    follower = TrainingFolder(folder.path, record_with(replace(SIX_STEPS, steps=9)))
    read_extensions(follower)  # as another process of the training does
    assert follower.record == third.record


@pytest.mark.parametrize("epochs", [None, 3])
def test_the_number_of_epochs_may_differ_because_the_steps_say_it_all(tmp_path, epochs):
    folder = start_training_folder(tmp_path / "out")
    resume(folder.path, replace(EIGHT_STEPS, epochs=epochs))


def test_a_training_is_not_resumed_with_fewer_steps_or_another_setting_besides_more_steps(tmp_path):
    folder = start_training_folder(tmp_path / "out")
    before = (folder.path / "training.json").read_bytes()
    with pytest.raises(UsageError, match=r"the training has steps 6; got 5\. A training may be resumed with more"):
        resume(folder.path, replace(SIX_STEPS, steps=5))
    with pytest.raises(UsageError, match=r"the training began with seed 0; got 1\."):
        resume(folder.path, replace(EIGHT_STEPS, seed=1))
    assert (folder.path / "training.json").read_bytes() == before
    assert {path.name for path in folder.path.iterdir()} == {"training.json"}


@pytest.mark.parametrize(
    ("other", "message"),
    [
        (record_with(replace(SIX_STEPS, learning_rate=1e-3)), "learning_rate 0.0002; got 0.001"),
        (record_with(replace(SIX_STEPS, pv_supervision=False)), "pv_supervision True; got False"),
        (record_with(config=replace(TINY, preset="nano")), "preset 'tiny'; got 'nano'"),
        (record_with(config=replace(TINY, num_frames=3)), "config.num_frames 4; got 3"),
        (replace(record_with(), data="others"), "data 'fixed clips'; got 'others'"),
        (replace(record_with(), start="0123"), r"start \(sha256 of the initial weights\) 'random'; got '0123'"),
        (replace(record_with(replace(SIX_STEPS, seed=1)), data="others", start="0123"), "seed 0; got 1"),
    ],
)
def test_a_training_is_only_resumed_with_the_same_record(tmp_path, other, message):
    trainer = new_trainer(SIX_STEPS)
    begin_or_resume(TrainingFolder(tmp_path, record_with()), trainer, resume=False)
    begin_or_resume(TrainingFolder(tmp_path, record_with()), trainer, resume=True)
    with pytest.raises(UsageError, match=f"the training began with {message}. Use the same settings"):
        begin_or_resume(TrainingFolder(tmp_path, other), trainer, resume=True)


@pytest.mark.parametrize("extended", [None, 3, [3], [{}], [{"at_step": 1, "old_steps": 6}], [{"at_step": "x"}], "text"])
def test_extensions_that_no_training_writes_are_refused(tmp_path, extended):
    folder = start_training_folder(tmp_path / "out")
    record = json.loads((folder.path / "training.json").read_text())
    (folder.path / "training.json").write_text(json.dumps(record | {"extended": extended}))
    with pytest.raises(ArtifactError, match=r"training\.json: expected the extensions of the training as `extended`"):
        resume(folder.path, SIX_STEPS)


@pytest.mark.parametrize("steps", [None, "6", 6.5])
def test_a_record_without_a_number_of_steps_is_refused(tmp_path, steps):
    folder = start_training_folder(tmp_path / "out")
    record = json.loads((folder.path / "training.json").read_text())
    record["settings"]["steps"] = steps
    (folder.path / "training.json").write_text(json.dumps(record))
    with pytest.raises(ArtifactError, match=r"training\.json: expected the number of steps of the training; got "):
        resume(folder.path, SIX_STEPS)


@pytest.mark.parametrize("name", ["best.safetensors", "tensorboard", "log.jsonl"])
def test_files_of_the_user_in_the_folder_are_not_overwritten(tmp_path, name):
    (tmp_path / name).write_text("mine")
    with pytest.raises(OutputError, match=f"{name}: no training.json shows that a training wrote this file"):
        check_training_folder(tmp_path, resume=False)
