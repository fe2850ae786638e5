"""Tests of the settings of a training: from a recipe and options, and for a model and its data."""

from dataclasses import replace

import pytest

from duospacenet.jobs.training.requested_settings import settings_for, training_settings
from duospacenet.model.presets import ablate
from duospacenet.runtime.errors import UsageError
from duospacenet.training import Settings
from duospacenet.training.recipe import read_recipe
from tests.helpers.trainings import TINY


def test_the_settings_are_those_of_the_recipe_with_the_given_options():
    assert training_settings({"seed": 3, "steps": None}) == Settings(seed=3)
    paper = training_settings({"batch_size": 4}, "paper", ["dropout=0"])
    assert paper == replace(read_recipe("paper"), batch_size=4, dropout=0)


@pytest.mark.parametrize(("num_samples", "batch_size", "steps"), [(7, 2, 3 * 4), (8, 2, 3 * 4), (1, 8, 3)])
def test_an_epoch_has_one_step_per_batch_and_its_last_batch_may_be_smaller(num_samples, batch_size, steps):
    settings = Settings(epochs=3, batch_size=batch_size)
    assert settings_for(settings, TINY, num_samples) == replace(settings, steps=steps)


def test_without_epochs_the_steps_stay():
    assert settings_for(Settings(steps=5), TINY, 7).steps == 5
    assert settings_for(Settings(steps=5), TINY, None).steps == 5


def test_frozen_parts_are_parts_of_the_model_and_leave_something_to_train():
    assert settings_for(Settings(frozen_parts=("lifter",)), TINY, None).frozen_parts == ("lifter",)
    expected = "frozen_parts: expected parts of tiny-pv, which are image_encoder, queries, decoder; got 'lifter'"
    with pytest.raises(UsageError, match=expected):
        settings_for(Settings(frozen_parts=("lifter",)), ablate(TINY, "pv"), None)
    parts = ("image_encoder", "lifter", "divergence_enhancement", "segmentation")
    with pytest.raises(UsageError, match=rf"to be left \({', '.join(parts)}\); got all of them"):
        settings_for(Settings(frozen_parts=parts, tasks="maps"), TINY, None)
    with pytest.raises(UsageError, match="frozen_parts"):
        training_settings({}, assignments=['frozen_parts=["neck"]'])


def test_a_yaw_free_class_may_be_one_of_nuscenes_or_of_the_model():
    cars_only = replace(TINY, classes=("car", "robot"))
    for name in ("traffic_cone", "robot"):
        assert settings_for(Settings(yaw_free_classes=(name,)), cars_only, None).yaw_free_classes == (name,)
    with pytest.raises(UsageError, match="yaw_free_classes: expected some of the classes car, robot; got 'cone'"):
        settings_for(Settings(yaw_free_classes=("cone",)), cars_only, None)
