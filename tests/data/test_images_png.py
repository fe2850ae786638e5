"""Writing PNG files."""

import cv2
import numpy as np
import pytest

from duospacenet.data.images import write_png
from duospacenet.runtime.errors import OutputError


class TestPng:
    def test_a_written_picture_is_read_back_unchanged(self, tmp_path):
        picture = np.random.default_rng(0).integers(0, 256, (7, 5, 3), dtype=np.uint8)
        write_png(tmp_path / "a.png", picture)
        np.testing.assert_array_equal(cv2.imread(str(tmp_path / "a.png")), picture)
        assert [path.name for path in tmp_path.iterdir()] == ["a.png"]

    def test_a_picture_that_cannot_be_written_is_refused_with_its_path(self, tmp_path):
        with pytest.raises(OutputError, match=r"missing/a\.png") as refused:
            write_png(tmp_path / "missing" / "a.png", np.zeros((4, 4, 3), np.uint8))
        assert refused.value.exit_code == 5
