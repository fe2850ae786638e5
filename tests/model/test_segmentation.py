"""Map segmentation equals the equations of a U-Net, and has a mask for each map class."""

from dataclasses import replace

from duospacenet.model.segmentation import MapSegmentation
from tests.helpers import references
from tests.helpers.model_inputs import ASYMMETRIC, assert_close, bev_features, with_random_weights


def test_the_masks_equal_the_equations():
    segmentation, bev = with_random_weights(MapSegmentation(ASYMMETRIC)).double(), bev_features(ASYMMETRIC).double()
    masks = segmentation(bev)
    expected = references.segmentation(references.weights_of(segmentation), bev[0].numpy(), ASYMMETRIC.map_classes)
    assert list(masks) == ["drivable_area", "lane_boundary"]
    for name, mask in masks.items():
        assert mask.shape == (1, 1, 12, 8)
        assert_close(mask[0], expected[name], 1e-10)


def test_there_is_a_mask_for_each_map_class_of_the_configuration_in_its_order():
    config = replace(ASYMMETRIC, map_classes=("walkway", "drivable_area", "crossing"))
    masks = with_random_weights(MapSegmentation(config))(bev_features(config))
    assert list(masks) == ["walkway", "drivable_area", "crossing"]
