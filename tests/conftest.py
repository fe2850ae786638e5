"""What many tests share: a tiny model, its bundle, exported once a run and loaded, and drawn drives to run it on."""

import shutil
from pathlib import Path

import pytest

from duospacenet.model import PRESETS, DuoSpaceNet, randomise
from duospacenet.runtime import Frame, Pipeline
from duospacenet.synthetic.drive import SyntheticDrive
from tests.helpers.streams import TINY_SIZE_PX

SHARED_SEED = 0


@pytest.fixture(scope="session")
def tiny_model() -> DuoSpaceNet:
    """A tiny model with random weights. Tests that change it take a copy."""
    return randomise(DuoSpaceNet(PRESETS["tiny"]), SHARED_SEED).eval()


@pytest.fixture(scope="session")
def tiny_export(tiny_model: DuoSpaceNet, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict]:
    """The bundle of `tiny_model`, and the traces that it was made of, by graph."""
    from tests.helpers.exports import export_with_traces

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


@pytest.fixture
def traced_already(tiny_bundle: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Exports of `tiny_model` take the graphs that were traced for its bundle; all else of an export happens anew."""
    from duospacenet.export import bundle

    monkeypatch.setattr(bundle, "trace", lambda graph, path, dcn: shutil.copy(tiny_bundle / path.name, path))


@pytest.fixture(scope="session")
def pipeline(tiny_bundle) -> Pipeline:
    """The tiny bundle at work. Tests that change it take `Pipeline(pipeline.manifest, ...)`."""
    return Pipeline.load(tiny_bundle)


@pytest.fixture(scope="session")
def frames() -> list[Frame]:
    """Six frames of one scene, half a second apart. Tests that change one take a copy."""
    return list(SyntheticDrive(1, frames=6, image_size=TINY_SIZE_PX))


@pytest.fixture(scope="session")
def other_frames() -> list[Frame]:
    """Six frames of another scene, of another rig."""
    return list(SyntheticDrive(2, frames=6, image_size=TINY_SIZE_PX))
