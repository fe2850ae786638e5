"""Checks that every table of the nuScenes classes has the same ten class names.

The model's configuration lists them. The tables are in packages that may not import each other.
"""

import pytest

from duospacenet.data.class_names import DETECTION_CLASSES
from duospacenet.drawing.box_style import CLASS_COLOURS
from duospacenet.evaluation.protocol import CLASS_RANGES_M
from duospacenet.model.config import NUSCENES_CLASSES
from duospacenet.synthetic.class_sizes import CLASS_SIZES_M

TABLES = {
    "colours": CLASS_COLOURS,
    "ranges": CLASS_RANGES_M,
    "sizes": CLASS_SIZES_M,
    "detection classes": DETECTION_CLASSES,
}


@pytest.mark.parametrize("table", TABLES.values(), ids=TABLES)
def test_every_table_of_classes_has_the_classes_of_the_model(table):
    assert set(table) == set(NUSCENES_CLASSES)
    assert len(table) == 10
