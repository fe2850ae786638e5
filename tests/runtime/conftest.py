"""The tiny bundle, loaded once, and drawn drives to run it on."""

import pytest
from driving import TINY_SIZE_PX

from duospacenet.runtime import Frame, Pipeline
from duospacenet.runtime.sources.synthetic import SyntheticDrive


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
