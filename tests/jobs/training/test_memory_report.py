"""Tests of the message on the memory of a training."""

from dataclasses import replace

import pytest

from duospacenet.jobs.training.memory_report import describe_memory
from duospacenet.training import Settings
from duospacenet.training.memory_estimate import estimate_memory
from tests.helpers.trainings import TINY

# Six images of 480x360 pixels have 1,036,800 pixels.
CONFIG = replace(TINY, image=replace(TINY.image, width_px=480, height_px=360), num_layers=1, num_frames=1)
PLAIN = Settings(denoising=0, pv_supervision=False, bev_supervision=False)


@pytest.mark.parametrize(("batch_size", "processes", "parts", "frames"), [(4, 2, 1, 2), (3, 1, 2, 2), (8, 2, 4, 1)])
def test_the_message_is_on_the_frames_that_are_computed_at_once(batch_size, processes, parts, frames):
    settings = replace(PLAIN, batch_size=batch_size)
    message = describe_memory(CONFIG, settings, processes, parts, checkpointing=True)
    estimate = estimate_memory(CONFIG, settings, frames, checkpointing=True)
    assert message == f"memory per GPU: {estimate}; a CPU needs the same"


def test_checkpointing_is_suggested_if_it_is_off():
    message = describe_memory(CONFIG, replace(PLAIN, batch_size=1), 1, 1, checkpointing=False)
    assert message is not None
    assert message.endswith("; a CPU needs the same. --activation-checkpointing needs less")


def test_a_small_training_has_no_message():
    assert describe_memory(TINY, replace(PLAIN, batch_size=16), 1, 1, checkpointing=False) is None
