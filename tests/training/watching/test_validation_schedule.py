"""Tests of the validation schedule: the steps that are validated, and the best scores."""

import pytest

from duospacenet.training.watching.validation_schedule import ValidationSchedule
from duospacenet.training.watching.validation_scores import ValidationScores


def scores_at(step, nds=0.5, data="drives"):
    return ValidationScores(step, data, 0.3, nds, 1.0)


def validated_steps(every, num_steps, batch_steps, interrupted_at=None):
    """The steps after which a training validates, whose batches of clips take `batch_steps` steps.

    interrupted_at: a step at which the training is resumed, with a schedule from the log.
    """
    validated, schedule, step = [], ValidationSchedule(every, "drives", []), 0
    while step < num_steps:
        step = min(step + batch_steps, num_steps)
        if schedule.is_due(step, num_steps):
            schedule.add(scores_at(step))
            validated.append(step)
        if step == interrupted_at:
            schedule = ValidationSchedule(every, "drives", map(scores_at, validated))
    return validated


@pytest.mark.parametrize(
    ("every", "num_steps", "batch_steps", "expected"),
    [
        (3, 9, 1, [3, 6, 9]),
        (3, 10, 1, [3, 6, 9, 10]),
        (3, 10, 4, [4, 8, 10]),  # at the first end of a batch after 3, 6 and 9
        (3, 14, 6, [6, 12, 14]),  # once after several multiples
        (100, 7, 2, [7]),
        (1, 3, 1, [1, 2, 3]),
    ],
)
def test_a_model_is_validated_at_the_ends_of_batches_and_after_the_last_step(every, num_steps, batch_steps, expected):
    assert validated_steps(every, num_steps, batch_steps) == expected


@pytest.mark.parametrize("interrupted_at", [2, 4, 6, 8])
def test_a_resumed_training_validates_the_same_steps(interrupted_at):
    assert validated_steps(3, 10, 2, interrupted_at) == validated_steps(3, 10, 2) == [4, 6, 10]


def test_a_validation_that_an_interruption_prevented_is_due_when_the_training_resumes():
    assert ValidationSchedule(3, "drives", [scores_at(3)]).is_due(6, 10)
    assert not ValidationSchedule(3, "drives", [scores_at(3), scores_at(6)]).is_due(6, 10)


def test_a_finished_training_is_not_validated_again_and_an_extended_one_goes_on():
    finished = [scores_at(3), scores_at(4)]
    assert not ValidationSchedule(3, "drives", finished).is_due(4, 4)
    extended = ValidationSchedule(3, "drives", finished)
    assert [step for step in range(4, 10) if extended.is_due(step, 10)] == [6, 7, 8, 9]


def test_of_equal_scores_the_earliest_is_the_best():
    schedule = ValidationSchedule(1, "drives", [scores_at(1, 0.2), scores_at(2, 0.4), scores_at(3, 0.4)])
    assert schedule.best().step == 2
    schedule.add(scores_at(4, 0.5))
    assert schedule.best().step == 4
    assert ValidationSchedule(1, "drives", []).best() is None


def test_scores_on_other_sources_do_not_count():
    schedule = ValidationSchedule(3, "drives", [scores_at(3, 0.9, data="others")])
    assert schedule.best() is None
    assert schedule.is_due(3, 10)
