"""The folder of a batch while several processes want to write to it."""

import pytest

from duospacenet.jobs.batch.batch_folder import BATCH_NAME, SCENES, UNFINISHED, open_batch_folder
from duospacenet.jobs.notify import ignore
from duospacenet.runtime.errors import OutputError

SETTINGS = {"maps": False}


def test_a_batch_that_is_refused_leaves_the_folders_of_the_one_that_runs(tmp_path):
    with open_batch_folder(tmp_path, SETTINGS, resume=False, notify=ignore):
        with (
            pytest.raises(OutputError, match="another run is writing there"),
            open_batch_folder(tmp_path, SETTINGS, resume=True, notify=ignore),
        ):
            pytest.fail("two batches write to the folder")
        assert {BATCH_NAME, SCENES, UNFINISHED} <= {path.name for path in tmp_path.iterdir()}


def test_a_batch_without_any_scene_leaves_nothing_behind(tmp_path):
    with open_batch_folder(tmp_path / "out", SETTINGS, resume=False, notify=ignore):
        pass
    assert list((tmp_path / "out").iterdir()) == []
