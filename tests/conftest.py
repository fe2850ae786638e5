"""What many tests share: tiny models, and one exported tiny bundle a run."""

from pathlib import Path

import pytest

from duospacenet.model import PRESETS, DuoSpaceNet, randomise

SHARED_SEED = 0


@pytest.fixture(scope="session")
def tiny_model() -> DuoSpaceNet:
    """A tiny model with random weights. Tests that change it take a copy."""
    return randomise(DuoSpaceNet(PRESETS["tiny"]), SHARED_SEED).eval()


@pytest.fixture(scope="session")
def tiny_bundle(tiny_model: DuoSpaceNet, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The bundle of `tiny_model`. Tests that change it take a copy."""
    from duospacenet.export import export_bundle

    out = tmp_path_factory.mktemp("bundles") / "tiny"
    export_bundle(tiny_model, out)
    return out
