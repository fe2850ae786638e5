"""The size of an image, read from its header."""

import numpy as np
import pytest

from duospacenet.data.images import read_image_size, write_png
from duospacenet.runtime.errors import InputError


def test_the_size_is_width_and_height(tmp_path):
    write_png(tmp_path / "a.png", np.zeros((20, 30, 3), np.uint8))
    assert read_image_size(tmp_path / "a.png") == (30, 20)
    with pytest.raises(InputError, match="no such file"):
        read_image_size(tmp_path / "b.png")
