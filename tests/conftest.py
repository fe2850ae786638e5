"""Shared fixtures: a tiny model, its bundle, which is exported once per test run, and frames of synthetic scenes."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from duospacenet.model import PRESETS, DuoSpaceNet, randomise
from duospacenet.runtime import Frame, Pipeline
from duospacenet.synthetic.drive import SyntheticDrive
from tests.helpers.processes import kill_leftovers
from tests.helpers.streams import TINY_SIZE_PX

TINY_MODEL_SEED = 0


@pytest.fixture(autouse=True)
def no_leftover_processes() -> Iterator[None]:
    """A failed test leaves no process running, which would slow down the tests after it."""
    yield
    kill_leftovers()


@pytest.fixture(scope="session", autouse=True)
def cache_folder_of_the_session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Indices of nuScenes roots are not written to the user's cache folder."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DUOSPACENET_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="session")
def tiny_model() -> DuoSpaceNet:
    """A tiny model with random weights. Tests that change it make a copy."""
    return randomise(DuoSpaceNet(PRESETS["tiny"]), TINY_MODEL_SEED).eval()


@pytest.fixture(scope="session")
def tiny_export(tiny_model: DuoSpaceNet, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict]:
    """The bundle of `tiny_model`, and the traces of its graphs by name."""
    from tests.helpers.exports import export_with_traces

    out = tmp_path_factory.mktemp("bundles") / "tiny"
    return out, export_with_traces(tiny_model, out)


@pytest.fixture(scope="session")
def tiny_bundle(tiny_export: tuple[Path, dict]) -> Path:
    """The bundle of `tiny_model`. Tests that change it make a copy."""
    return tiny_export[0]


@pytest.fixture
def copied_bundle(tiny_bundle: Path, tmp_path: Path) -> Path:
    """A copy of `tiny_bundle` that a test may change."""
    return shutil.copytree(tiny_bundle, tmp_path / "bundle")


@pytest.fixture(scope="session")
def portable_bundle(tiny_model: DuoSpaceNet, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The bundle of `tiny_model` in the grid-sample form, for engines without dynamic shapes."""
    from duospacenet.export import export_bundle
    from tests.helpers.exports import share_conversions

    out = tmp_path_factory.mktemp("bundles") / "portable"
    with share_conversions():
        export_bundle(tiny_model, out, attention="grid-sample")
    return out


@pytest.fixture
def copied_portable_bundle(portable_bundle: Path, tmp_path: Path) -> Path:
    """A copy of `portable_bundle` that a test may change."""
    return shutil.copytree(portable_bundle, tmp_path / "bundle")


@pytest.fixture(scope="session")
def tiny_int8_bundle(tiny_bundle: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`tiny_bundle`, quantized on a few frames. Tests that change it make a copy."""
    from tests.helpers.quantized import quantize_tiny

    return quantize_tiny(tiny_bundle, tmp_path_factory.mktemp("bundles") / "tiny-int8").bundle


@pytest.fixture(scope="session")
def tiny_traces(tiny_export: tuple[Path, dict]) -> dict:
    """The traces of `tiny_bundle`, so that a bisection need not trace again."""
    return tiny_export[1]


@pytest.fixture
def reuse_traced_graphs(tiny_bundle: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Exports of `tiny_model` copy its already traced graphs, which saves time. All other steps of the export run."""
    from duospacenet.export import bundle

    monkeypatch.setattr(bundle, "trace", lambda graph, path, forms: shutil.copy(tiny_bundle / path.name, path))


@pytest.fixture(scope="session")
def pipeline(tiny_bundle) -> Pipeline:
    """The loaded bundle of `tiny_model`. Tests that change it make a new `Pipeline(pipeline.manifest, ...)`."""
    return Pipeline.load(tiny_bundle)


@pytest.fixture(scope="session")
def frames() -> list[Frame]:
    """Six frames of one scene, half a second apart. Tests that change one make a copy."""
    return list(SyntheticDrive(1, frames=6, image_size=TINY_SIZE_PX))


@pytest.fixture(scope="session")
def other_frames() -> list[Frame]:
    """Six frames of another scene with another rig."""
    return list(SyntheticDrive(2, frames=6, image_size=TINY_SIZE_PX))
