"""Small models for the tests of checkpoints."""

from dataclasses import replace

import pytest

from duospacenet.model import PRESETS, DuoSpaceNet, randomise
from tests.helpers.checkpoints import small_network
from tests.helpers.vovnets import SMALL as VOVNET


@pytest.fixture(scope="module")
def weights():
    """The tensors of a ResNet, which differ from those of `model`."""
    return small_network(seed=1).state_dict()


@pytest.fixture
def model():
    """A small ResNet: it has convolutions, norms and counters."""
    return small_network(seed=2)


@pytest.fixture
def other():
    """A tiny model without any number in common with `tiny_model`."""
    return randomise(DuoSpaceNet(PRESETS["tiny"]), seed=7)


@pytest.fixture(scope="module")
def vovnet_model():
    """A tiny model with a VoVNet."""
    return randomise(DuoSpaceNet(replace(PRESETS["tiny"], backbone=VOVNET)), seed=0)


@pytest.fixture
def other_vovnet():
    """A tiny model with a VoVNet, without any number in common with `vovnet_model`."""
    return randomise(DuoSpaceNet(replace(PRESETS["tiny"], backbone=VOVNET)), seed=7)
