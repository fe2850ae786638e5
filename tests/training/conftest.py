"""Fixtures that several training tests share."""

import pytest
import torch

from tests.helpers.trainings import (
    SIX_STEPS,
    FixedClips,
    continue_training,
    new_trainer,
    start_training_folder,
    synthetic_frames,
)


@pytest.fixture(scope="package", autouse=True)
def one_thread():
    """Use one thread. The operators of the tiny model are small, and threads wait for each other on a busy machine."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="session")
def two_clips():
    """Clips of two frames and of one frame from another scene: batches of one take 2, 1, 2 and 1 steps."""
    return FixedClips((synthetic_frames(1, 2), synthetic_frames(2, 1)))


@pytest.fixture(scope="session")
def finished(two_clips, tmp_path_factory):
    """The folder of an uninterrupted training. Do not change its files."""
    folder = start_training_folder(tmp_path_factory.mktemp("training") / "finished")
    reports = list(continue_training(folder, new_trainer(SIX_STEPS), two_clips))
    assert [report.step.number for report in reports] == list(range(6))
    return folder
