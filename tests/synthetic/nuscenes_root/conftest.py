"""A root that all tests of this folder read."""

import pytest

from tests.helpers.nuscenes_roots import PlainTables, write_small_root

SEED = 3
NUM_FRAMES = 8


@pytest.fixture(scope="session")
def tables(tmp_path_factory) -> PlainTables:
    """The tables of a root with two scenes."""
    return PlainTables(write_small_root(tmp_path_factory.mktemp("roots") / "root", 2, NUM_FRAMES, seed=SEED))
