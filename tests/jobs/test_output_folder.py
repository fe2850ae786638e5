"""The output folder: it is never that of the source."""

import pytest

from duospacenet.jobs.output_folder import check_not_source
from duospacenet.runtime.errors import UsageError


@pytest.mark.parametrize("source", ["", "scene.json"])
def test_the_folder_of_the_source_is_refused(tmp_path, source):
    (tmp_path / "scene.json").touch()
    with pytest.raises(UsageError, match="expected a folder other than the source's"):
        check_not_source(tmp_path, tmp_path / source)
    check_not_source(tmp_path / "out", tmp_path / source)
