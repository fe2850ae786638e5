"""Map segmentation: masks by name, at the size of the BEV features, by the equations of a U-Net."""

from dataclasses import replace

from duospacenet.model.segmentation import MapSegmentation
from tests.helpers import references
from tests.helpers.model_inputs import LOPSIDED, assert_close, bev_features, drawn


def test_the_masks_equal_the_equations():
    segmentation, bev = drawn(MapSegmentation(LOPSIDED)).double(), bev_features(LOPSIDED).double()
    masks = segmentation(bev)
    expected = references.segmentation(references.weights_of(segmentation), bev[0].numpy(), LOPSIDED.map_classes)
    assert list(masks) == ["drivable_area", "lane_boundary"]
    for name, mask in masks.items():
        assert mask.shape == (1, 1, 12, 8)
        assert_close(mask[0], expected[name], 1e-10)


def test_there_is_a_mask_for_each_map_class_of_the_configuration_in_its_order():
    config = replace(LOPSIDED, map_classes=("walkway", "drivable_area", "crossing"))
    assert list(drawn(MapSegmentation(config))(bev_features(config))) == ["walkway", "drivable_area", "crossing"]
