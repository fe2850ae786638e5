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
def tiny_export(tiny_model: DuoSpaceNet, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict]:
    """The bundle of `tiny_model`, and the traces that it was made of, by graph."""
    from exporting import export_with_traces

    out = tmp_path_factory.mktemp("bundles") / "tiny"
    return out, export_with_traces(tiny_model, out)


@pytest.fixture(scope="session")
def tiny_bundle(tiny_export: tuple[Path, dict]) -> Path:
    """The bundle of `tiny_model`. Tests that change it take a copy."""
    return tiny_export[0]


@pytest.fixture(scope="session")
def tiny_traces(tiny_export: tuple[Path, dict]) -> dict:
    """The traces of `tiny_bundle`, so that a bisection need not make them again."""
    return tiny_export[1]
