"""The layout and the caption of the picture of a frame."""

import numpy as np
import pytest

from duospacenet.drawing.frame_picture import camera_rows, caption, draw_frame, lay_out_cameras
from duospacenet.runtime.frame import GroundTruth
from tests.helpers.pictures import NUSCENES_AZIMUTHS_DEG, box, looking, make_frame, surround_frame


class TestLayout:
    def test_nuscenes_cameras_are_placed_by_their_azimuth(self):
        cameras = {name: looking(azimuth) for name, azimuth in NUSCENES_AZIMUTHS_DEG.items()}
        assert camera_rows(cameras) == (
            ["CAM_FRONT_LEFT", "CAM_FRONT", "CAM_FRONT_RIGHT"],
            ["CAM_BACK_LEFT", "CAM_BACK", "CAM_BACK_RIGHT"],
        )

    @pytest.mark.parametrize(
        ("azimuths", "rows"),
        [
            ([], ([], [])),
            ([0], ([0], [])),
            ([0, 180], ([0], [180])),
            ([0, -88, 91, 180], ([91, 0, -88], [180])),
            ([45, -45, 135, -135], ([45, -45], [135, -135])),
            ([0, 45, -45, 90, -90], ([45, 0, -45], [90, -90])),
        ],
    )
    def test_other_rigs_have_at_most_two_rows(self, azimuths, rows):
        assert camera_rows({azimuth: looking(azimuth) for azimuth in azimuths}) == rows

    def test_panels_keep_the_aspect_ratio_of_their_cameras_and_do_not_overlap(self):
        cameras = {"wide": looking(30, width_px=1600, height_px=400), "high": looking(-30, height_px=900)}
        cells = lay_out_cameras(cameras, height_px=404, gap_px=4)
        assert cells["wide"][2:] == (800, 200)
        assert cells["high"][2:] == (142, 200)
        assert cells["wide"].left + 800 < cells["high"].left
        assert cells["wide"].top == cells["high"].top == 102

    def test_the_picture_shows_each_image_in_its_place(self):
        picture = draw_frame(surround_frame(), np.zeros((0, 9)), [], height_px=720)
        assert picture.shape[0] == 720
        assert picture.shape[1] % 2 == 0
        greys = {name: 100 + 20 * i for i, name in enumerate(NUSCENES_AZIMUTHS_DEG)}
        rows = camera_rows(surround_frame().cameras)
        for v, row in zip((170, 514), rows, strict=True):
            for u, name in zip((302, 910, 1518), row, strict=True):
                assert picture[v, u].tolist() == [greys[name]] * 3

    def test_a_lost_camera_has_a_dark_panel_with_a_text(self):
        boxes = box(12, 0)
        complete = draw_frame(surround_frame(), boxes, ["car"])
        picture = draw_frame(surround_frame(lost=["CAM_FRONT"]), boxes, ["car"])
        panel = picture[30:340, 612:1210]
        assert panel.mean() < 30
        rows, columns = np.nonzero(panel.max(axis=2) > 100)
        assert abs(rows.mean() + 30 - 170) < 10
        assert abs(columns.mean() + 612 - 910) < 10
        np.testing.assert_array_equal(picture[:340, :604], complete[:340, :604])

    def test_a_rig_without_cameras_has_a_bird_eye_view(self):
        picture = draw_frame(make_frame({}, {}), box(20, 10), ["car"], height_px=360)
        assert picture.shape[0] == 360

    @pytest.mark.parametrize("height_px", [240, 720, 1440])
    def test_the_picture_has_the_requested_height(self, height_px):
        picture = draw_frame(surround_frame(), box(12, 0), ["tram"], [0.5], height_px=height_px)
        assert picture.shape[0] == height_px
        assert picture.shape[1] % 2 == 0

    def test_drawing_does_not_change_the_images(self):
        frame = surround_frame()
        draw_frame(frame, box(12, 0), ["car"])
        assert all((image == image[0, 0]).all() for image in frame.images.values())

    def test_different_numbers_of_boxes_classes_and_scores_are_refused(self):
        with pytest.raises(ValueError, match="1 boxes, 2 classes"):
            draw_frame(surround_frame(), box(12, 0), ["car", "bus"])
        with pytest.raises(ValueError, match="1 classes and 2 scores"):
            draw_frame(surround_frame(), box(12, 0), ["car"], [0.1, 0.2])


class TestCaption:
    def test_it_contains_the_scene_the_token_and_the_number_of_boxes(self):
        assert caption(surround_frame(), 1, None, None).split() == ["s", "t", "1", "box"]

    def test_it_contains_the_time_since_the_start_and_the_number_of_ground_truth_boxes(self):
        ground_truth = GroundTruth(boxes=np.zeros((2, 9)), classes=("car", "bus"))
        assert caption(surround_frame(), 3, ground_truth, 11.0).split() == [
            "s",
            "+1.50",
            "s",
            "3",
            "boxes",
            "2",
            "ground",
            "truth",
        ]
