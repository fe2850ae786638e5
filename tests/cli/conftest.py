"""Fixtures of the tests of `duospacenet train`."""

from pathlib import Path

import pytest

from duospacenet.data.scene_writer import write_scene
from duospacenet.model import DuoSpaceNet, randomise
from duospacenet.weights import save_checkpoint
from tests.helpers.train_command import TRAIN_TINY
from tests.helpers.trainings import TINY, synthetic_frames


@pytest.fixture(scope="session")
def training_scene(tmp_path_factory) -> Path:
    """A scene folder of three frames."""
    folder = tmp_path_factory.mktemp("scenes") / "scene"
    write_scene(folder, synthetic_frames(1, 3))
    return folder


@pytest.fixture(scope="session")
def initial_weights(tmp_path_factory) -> Path:
    """Weights to start from, so that no anchors are clustered."""
    path = tmp_path_factory.mktemp("weights") / "tiny.safetensors"
    save_checkpoint(path, randomise(DuoSpaceNet(TINY), 0))
    return path


@pytest.fixture
def train_tiny(training_scene, initial_weights) -> list[str]:
    """The arguments of a training of four steps, without --out."""
    return [*TRAIN_TINY, "--source", str(training_scene), "--weights", str(initial_weights)]
