"""Checks that every table of the nuScenes classes has the same ten class names.

The model's configuration lists them. The tables are in packages that may not import each other.
"""

import pytest

from duospacenet.drawing.box_style import CLASS_COLOURS
from duospacenet.evaluation.protocol import CLASS_RANGES_M
from duospacenet.model.config import NUSCENES_CLASSES
from duospacenet.synthetic.class_sizes import CLASS_SIZES_M


@pytest.mark.parametrize("table", [CLASS_COLOURS, CLASS_RANGES_M, CLASS_SIZES_M], ids=["colours", "ranges", "sizes"])
def test_every_table_of_classes_has_the_classes_of_the_model(table):
    assert set(table) == set(NUSCENES_CLASSES)
    assert len(table) == 10
