"""The picture of a frame's features: its panels, its patches and the marks."""

import numpy as np
import pytest

from duospacenet.drawing.feature_panels import FeatureMaps
from duospacenet.drawing.heatmap_picture import (
    MARK_COLOUR,
    MAX_PATCHED_OBJECTS,
    PATCH_PX,
    DetectedObject,
    draw_heatmaps,
)
from duospacenet.drawing.panel_layout import GAP_PX
from tests.drawing.test_feature_panels import NETWORK
from tests.helpers.pictures import box, surround_frame

PANEL_PX = (420, 168)
BODY_PX = 4 * PANEL_PX[1] + 3 * GAP_PX


def features(frame, pv=True, bev=True):
    rng = np.random.default_rng(0)
    levels = {name: rng.normal(size=(4, 8, 20)).astype(np.float32) for name in frame.cameras}
    levels = {name: level for name, level in levels.items() if frame.images[name] is not None}
    return FeatureMaps(levels if pv else None, rng.normal(size=(4, 32, 32)).astype(np.float32) if bev else None)


def draw(frame, objects=(), notes=("note",), **kinds):
    named = [DetectedObject(each[0], "car 0.50") for each in objects]
    return draw_heatmaps(frame, features(frame, **kinds), named, NETWORK, 51.2, notes)


def marks(picture):
    return int((picture == MARK_COLOUR).all(axis=2).sum())


def test_images_are_above_their_heatmaps_and_beside_the_bev_heatmap():
    frame = surround_frame()
    picture = draw(frame)
    assert picture.shape[1] == 3 * PANEL_PX[0] + 2 * GAP_PX + GAP_PX + BODY_PX
    assert picture[100, 630].tolist() == [100] * 3  # the front camera, in the middle of the first row
    assert picture[PANEL_PX[1] + GAP_PX + 100, 630].tolist() == [160] * 3  # the rear camera
    heat = picture[2 * (PANEL_PX[1] + GAP_PX) : BODY_PX, :1272]
    assert np.ptp(heat.reshape(-1, 3).astype(int), axis=0).min() > 100


def test_a_lost_camera_has_neither_image_nor_heat():
    picture = draw(surround_frame(lost=["CAM_FRONT"]))
    middle = slice(PANEL_PX[0] + GAP_PX + 150, 2 * PANEL_PX[0])
    top = 2 * (PANEL_PX[1] + GAP_PX)
    assert picture[top : top + PANEL_PX[1], middle].max() == 0
    assert picture[top : top + PANEL_PX[1], :100].max() > 150


def test_an_object_has_one_patch_of_each_kind_and_a_mark_in_each_panel():
    frame = surround_frame()
    frame.images["CAM_FRONT"][150:210, 290:350] = (0, 0, 255)  # where a box 10 m ahead is
    without, picture = draw(frame), draw(frame, [box(10, 0, w=2, l=2, h=2)])
    assert marks(without) == 0
    assert marks(picture) > 500
    assert len(picture) - len(without) == PATCH_PX + 26 + GAP_PX
    patch = picture[BODY_PX + GAP_PX + 26 :][:PATCH_PX]
    assert patch[PATCH_PX // 2, PATCH_PX // 2].tolist() == [0, 0, 255]
    assert marks(patch) == 0
    kinds = [patch[:, start : start + PATCH_PX] for start in range(0, 3 * (PATCH_PX + GAP_PX), PATCH_PX + GAP_PX)]
    assert all(kind.max() > 60 for kind in kinds)
    assert (picture[BODY_PX + GAP_PX + 26 :][:PATCH_PX, 3 * PATCH_PX + 4 * GAP_PX :].max()) < 30  # no fourth patch


def test_objects_that_no_camera_shows_and_second_boxes_of_an_object_have_no_patches():
    frame = surround_frame(lost=["CAM_BACK"])
    hidden, visible = box(-20, 0), box(20, 0)
    one = draw(frame, [visible])
    np.testing.assert_array_equal(draw(frame, [hidden, visible, box(21, 0.5), box(np.nan, 0)]), one)


def test_only_the_first_objects_have_patches():
    boxes = [box(15, 4 * number) for number in range(-6, 7)]
    picture = draw(surround_frame(), boxes)
    assert picture.shape == draw(surround_frame(), boxes[:MAX_PATCHED_OBJECTS]).shape


@pytest.mark.parametrize("kinds", [{"bev": False}, {"pv": False}, {"pv": False, "bev": False}])
def test_a_model_without_one_of_the_spaces_has_a_picture_too(kinds):
    frame = surround_frame()
    picture = draw(frame, [box(10, 0)], **kinds)
    assert picture[100, 630].tolist() == [100] * 3
    assert marks(picture) > 100
