"""The panels of a comparison: one per result, blue predictions over green truth, names and a legend."""

import numpy as np
import pytest

from duospacenet.drawing.box_style import GROUND_TRUTH_COLOUR, PREDICTION_COLOUR
from duospacenet.drawing.comparison_picture import (
    TITLE_PX,
    VIEW_PX,
    Comparison,
    NamedBoxes,
    draw_comparison_above,
    draw_comparison_in_cameras,
)
from duospacenet.drawing.ellipses import ELLIPSE_COLOUR
from duospacenet.drawing.panel_layout import GAP_PX
from duospacenet.runtime.frame import GroundTruth
from tests.helpers.pictures import box, count_hue, surround_frame

NO_BOXES = np.zeros((0, 9))
TRUTH = GroundTruth(boxes=box(30, 20), classes=("car",))


def comparison(results, truth=None, marked=NO_BOXES):
    return Comparison([NamedBoxes(name, boxes) for name, boxes in results.items()], truth, marked, "scene, token")


def views(picture, number):
    return [picture[TITLE_PX : TITLE_PX + VIEW_PX, i * (VIEW_PX + GAP_PX) :][:, :VIEW_PX] for i in range(number)]


def test_each_view_from_above_has_the_boxes_of_its_result_and_the_same_truth():
    picture = draw_comparison_above(comparison({"a": box(10, 0), "b": NO_BOXES}, TRUTH), 51.2)
    first, second = views(picture, 2)
    assert count_hue(first, PREDICTION_COLOUR) > 10
    assert count_hue(second, PREDICTION_COLOUR) == 0
    assert count_hue(first, GROUND_TRUTH_COLOUR) == count_hue(second, GROUND_TRUTH_COLOUR) > 10


def test_velocities_have_no_arrows():
    still, moving = (draw_comparison_above(comparison({"a": box(10, 0, vx=v)}), 51.2) for v in (0.0, 9.0))
    np.testing.assert_array_equal(still, moving)


def test_the_legend_names_only_what_is_drawn():
    plain = draw_comparison_above(comparison({"a": NO_BOXES}), 51.2)
    with_truth = draw_comparison_above(comparison({"a": NO_BOXES}, TRUTH), 51.2)
    marked = draw_comparison_above(comparison({"a": NO_BOXES}, TRUTH, TRUTH.boxes), 51.2)
    footers = [picture[TITLE_PX + VIEW_PX :] for picture in (plain, with_truth, marked)]
    assert [count_hue(footer, GROUND_TRUTH_COLOUR) > 100 for footer in footers] == [False, True, True]
    assert [count_hue(footer, ELLIPSE_COLOUR) > 100 for footer in footers] == [False, False, True]
    assert count_hue(views(marked, 1)[0], ELLIPSE_COLOUR) > 50


def test_a_fifth_result_begins_a_second_row():
    names = dict.fromkeys("abcde", NO_BOXES)
    picture = draw_comparison_above(comparison(names), 51.2)
    assert picture.shape[1] == 4 * VIEW_PX + 3 * GAP_PX
    assert picture.shape[0] > 2 * (VIEW_PX + TITLE_PX)


def test_the_camera_picture_has_one_row_per_result_with_the_images_in_the_given_order():
    frame = surround_frame(lost=["CAM_BACK"])
    picture = draw_comparison_in_cameras(
        comparison({"a": box(12, 0), "b": NO_BOXES}, TRUTH), frame, ["CAM_FRONT_LEFT", "CAM_FRONT", "CAM_BACK"]
    )
    width = 840
    height = round(width * 360 / 640)
    tops = [TITLE_PX, 2 * TITLE_PX + height + GAP_PX]
    for top in tops:
        row = picture[top : top + height]
        greys = [row[-40, column * (width + GAP_PX) + 40].tolist() for column in range(3)]
        assert greys[:2] == [[140] * 3, [100] * 3]  # the third and the first camera of the frame
        assert max(greys[2]) < 40  # lost
    assert count_hue(picture[tops[0] : tops[0] + height], PREDICTION_COLOUR) > 50
    assert count_hue(picture[tops[1] : tops[1] + height], PREDICTION_COLOUR) == 0


@pytest.mark.parametrize("name", ["x" * 300, "", "Größe"])
def test_any_name_fits_above_its_panel(name):
    picture = draw_comparison_above(comparison({name: NO_BOXES}), 51.2)
    assert picture.shape[1] == VIEW_PX
    assert picture[:TITLE_PX, -4:].max() < 30
