"""The output folder: which files are replaced."""

import pytest

from duospacenet.jobs.output_folder import check_not_source, prepare_folder
from duospacenet.runtime.errors import OutputError, UsageError


def test_only_files_that_match_are_replaced(tmp_path):
    for name in ("report.json", "mine.json"):
        (tmp_path / name).touch()
    with pytest.raises(OutputError, match=r"report\.json: an earlier run wrote this file"):
        prepare_folder(tmp_path, False, ["report.json"], ["pictures"])
    prepare_folder(tmp_path, True, ["report.json"], ["pictures"])
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine.json", "pictures"]


@pytest.mark.parametrize("source", ["", "scene.json"])
def test_the_folder_of_the_source_is_refused(tmp_path, source):
    (tmp_path / "scene.json").touch()
    with pytest.raises(UsageError, match="expected a folder other than the source's"):
        check_not_source(tmp_path, tmp_path / source)
    check_not_source(tmp_path / "out", tmp_path / source)
