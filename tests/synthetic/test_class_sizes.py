"""The tables by class have an entry for every class of nuScenes, and no other."""

from duospacenet.drawing.box_style import CLASS_COLOURS
from duospacenet.model.config import NUSCENES_CLASSES
from duospacenet.synthetic.class_sizes import CLASS_SIZES_M, WIDEST_M
from duospacenet.synthetic.object_meshes import ADD_FUNCTIONS
from tests.helpers.synthetic_scenes import CLASS_ORDER


def test_every_class_has_a_size_a_mesh_and_a_colour():
    assert tuple(CLASS_SIZES_M) == tuple(CLASS_COLOURS) == NUSCENES_CLASSES == CLASS_ORDER
    assert set(ADD_FUNCTIONS) - {"house", "tree", "lamp"} == set(NUSCENES_CLASSES)


def test_no_class_is_usually_wider_than_the_widest_object():
    assert max(width for width, _, _ in CLASS_SIZES_M.values()) < WIDEST_M
