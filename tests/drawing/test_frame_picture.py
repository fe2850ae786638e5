import cv2
import numpy as np
import pytest

from duospacenet.data.images import write_png
from duospacenet.drawing.bird_eye_view import draw_bird_eye_view
from duospacenet.drawing.box_style import CLASS_COLOURS, style_detections, style_ground_truth
from duospacenet.drawing.camera_panel import draw_camera, project_segments
from duospacenet.drawing.canvas import draw_segments
from duospacenet.drawing.frame_picture import camera_rows, caption, draw_frame, lay_out_cameras
from duospacenet.runtime.errors import OutputError
from duospacenet.runtime.frame import Camera, Frame, GroundTruth

# At the ego's origin, looking ahead: x right is y left negated, y down is z up negated, z is x.
AHEAD = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1.0]])
# The same, looking to the left of the ego.
LEFT = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1.0]])
SIZE_PX = (640, 360)
NUSCENES_AZIMUTHS_DEG = {
    "CAM_FRONT": 0,
    "CAM_FRONT_RIGHT": -55,
    "CAM_FRONT_LEFT": 55,
    "CAM_BACK": 180,
    "CAM_BACK_LEFT": 110,
    "CAM_BACK_RIGHT": -110,
}


def make_camera(camera_T_ego=AHEAD, width_px=640, height_px=360):
    """A pinhole of 200 px that looks through the middle of its image."""
    intrinsics_px = np.array([[200, 0, width_px / 2], [0, 200, height_px / 2], [0, 0, 1.0]])
    return Camera(intrinsics_px, camera_T_ego, width_px, height_px)


def looking(azimuth_deg, **size):
    cos, sin = np.cos(np.deg2rad(azimuth_deg)), np.sin(np.deg2rad(azimuth_deg))
    turned = np.eye(4)
    turned[:2, :2] = [[cos, sin], [-sin, cos]]
    return make_camera(AHEAD @ turned, **size)


def make_frame(images, cameras, **words):
    return Frame(images=images, cameras=cameras, global_T_ego=np.eye(4), timestamp_s=12.5, **words)


def surround_frame(lost=()):
    """nuScenes' six directions; the images are plain, each of another grey."""
    cameras = {name: looking(azimuth) for name, azimuth in NUSCENES_AZIMUTHS_DEG.items()}
    images = {name: np.full((360, 640, 3), 100 + 20 * i, np.uint8) for i, name in enumerate(cameras)}
    return make_frame(images | dict.fromkeys(lost), cameras, scene="s", token="t")


def box(x, y, z=0.0, w=2.0, l=4.0, h=2.0, yaw=0.0, vx=0.0, vy=0.0):  # noqa: E741
    return np.array([[x, y, z, w, l, h, yaw, vx, vy]])


def truth_of(boxes):
    return style_ground_truth(GroundTruth(boxes=boxes, classes=("car",) * len(boxes)), scale=1.0)


def panel_of(*marks, camera=None):
    """A camera's panel without its name, from a black image."""
    image = np.zeros((360, 640, 3), np.uint8)
    return draw_camera("", camera or make_camera(), image, list(marks), SIZE_PX, scale=1.0)


def drawn_on(panel):
    """(rows, columns) that differ from an empty panel."""
    return difference(panel, panel_of())


def difference(picture, other):
    """(rows, columns) that differ by more than the rim of an anti-aliased line."""
    return np.nonzero((np.abs(picture.astype(int) - other) > 60).any(axis=2))


class TestBoxesInCameras:
    def test_the_near_face_of_a_box_ten_metres_ahead_is_where_the_pinhole_puts_it(self):
        # x = 10, y = 1 and -1, z = 1 and -1: u = 320 -+ 20, v = 180 -+ 20; the far face, x = 14, lies within.
        rows, columns = drawn_on(panel_of(truth_of(box(12, 0))))
        assert (rows.min(), rows.max()) == (159, 200)
        assert (columns.min(), columns.max()) == (299, 340)

    def test_a_line_on_the_border_of_two_pixels_lights_both_alike(self):
        green = panel_of(truth_of(box(12, 0)))[..., 1].astype(int)
        left_of_300, right_of_300 = green[190, 299], green[190, 300]
        assert min(left_of_300, right_of_300) > 100
        assert abs(left_of_300 - right_of_300) < 20

    def test_the_panel_may_have_another_size_than_the_image(self):
        image = np.zeros((360, 640, 3), np.uint8)
        empty = draw_camera("", make_camera(), image, [], (320, 180), scale=1.0)
        panel = draw_camera("", make_camera(), image, [truth_of(box(12, 0))], (320, 180), scale=1.0)
        rows, columns = difference(panel, empty)
        assert (rows.min(), rows.max()) == (79, 100)
        assert (columns.min(), columns.max()) == (149, 170)

    def test_what_is_left_of_the_ego_is_ahead_of_a_camera_that_looks_left(self):
        rows, columns = drawn_on(panel_of(truth_of(box(0, 12, w=4, l=2)), camera=make_camera(LEFT)))
        assert (columns.min(), columns.max()) == (299, 340)
        assert (rows.min(), rows.max()) == (159, 200)

    def test_a_box_behind_the_camera_draws_nothing(self):
        assert drawn_on(panel_of(truth_of(box(-12, 0))))[0].size == 0

    def test_a_box_beside_the_picture_draws_nothing(self):
        assert drawn_on(panel_of(truth_of(box(10, 40))))[0].size == 0

    def test_a_box_partly_behind_the_camera_is_drawn_up_to_the_border_and_not_mirrored(self):
        # From x = 2 back past the camera, at y = 0.5 .. 2.5: the lower inner edge starts at u = 320 - 200 / 4
        # and v = 180 + 200 / 2, and runs down to the left along v - 180 = 2 (320 - u).
        panel = panel_of(truth_of(box(0, 1.5)))
        _, columns = drawn_on(panel)
        assert columns.max() in (269, 270, 271)
        assert columns.min() == 0
        assert panel[329:331, 244:246, 1].min() > 100

    def test_lines_are_cut_where_they_come_too_near(self):
        # From 2 m ahead to 2 m behind, one metre to the right: cut at depth 0.1 m, u = 320 + 200 / 0.1.
        line = np.array([[[2.0, -1.0, 0.0], [-2.0, -1.0, 0.0]]])
        pixels = project_segments(line, make_camera().intrinsics_px @ AHEAD[:3])
        np.testing.assert_allclose(pixels, [[[420, 180], [2320, 180]]])

    def test_a_nearer_box_is_drawn_over_a_farther_one_in_any_order(self):
        # The upper edge of the car's near face, x = 20 and z = 0, runs along v = 180, from u = 280 to 360;
        # the pedestrian's left edge, at u = 300, crosses it.
        boxes = np.concatenate([box(12, 0), box(22, 0, z=-1, w=8)])
        near_first = panel_of(style_detections(boxes, ["pedestrian", "car"], None, scale=0.5))
        far_first = panel_of(style_detections(boxes[::-1], ["car", "pedestrian"], None, scale=0.5))
        np.testing.assert_array_equal(near_first, far_first)
        beside, crossing = near_first[180, 290].astype(int), near_first[180, 300].astype(int)
        assert beside[0] > 1.5 * beside[2]  # blue, the car's
        assert crossing[2] > 1.5 * crossing[0]  # yellow, the pedestrian's

    def test_the_face_that_heads_the_box_is_tinted(self):
        # u = 303 lies on the near face, x = 10, but beside the far one, x = 14, which starts at u = 305.7.
        away = panel_of(style_detections(box(12, 0), ["car"], None, scale=0.5))
        toward = panel_of(style_detections(box(12, 0, yaw=np.pi), ["car"], None, scale=0.5))
        assert away[180, 303].max() == 0
        np.testing.assert_allclose(toward[180, 303], 0.35 * np.array(CLASS_COLOURS["car"]), atol=1)

    def test_truth_is_green_and_a_prediction_has_the_colour_of_its_class(self):
        rows, columns = drawn_on(panel_of(truth_of(box(12, 0))))
        blue, green, red = panel_of(truth_of(box(12, 0)))[rows, columns].sum(axis=0)
        assert green > 1.5 * max(blue, red)
        blue, green, red = panel_of(style_detections(box(12, 0), ["car"], None, 1.0)).sum(axis=(0, 1))
        assert blue > 1.3 * green > 1.3 * red

    def test_scores_are_written_over_boxes(self):
        without = panel_of(style_detections(box(12, 0), ["car"], None, 1.0))
        with_score = panel_of(style_detections(box(12, 0), ["car"], [0.87], 1.0))
        rows, columns = np.nonzero((with_score != without).any(axis=2))
        assert 140 < rows.min() < rows.max() < 160
        assert columns.min() >= 298

    @pytest.mark.parametrize("size_m", [1e3, 1e9, 1e300, np.nan, np.inf])
    @pytest.mark.filterwarnings("ignore::RuntimeWarning")
    def test_boxes_of_any_size_leave_the_other_boxes_as_they_are(self, size_m):
        boxes = np.concatenate([box(12, 0), box(12, 0, w=size_m, l=size_m, h=size_m)])
        picture = draw_frame(surround_frame(), boxes, ["car", "bus"], [0.5, 0.5])
        assert picture.shape == draw_frame(surround_frame(), box(12, 0), ["car"]).shape
        rows, columns = drawn_on(panel_of(truth_of(boxes)))
        assert {(160, 300), (199, 339)} <= set(zip(rows.tolist(), columns.tolist(), strict=True))

    @pytest.mark.filterwarnings("ignore::RuntimeWarning")
    def test_a_camera_that_looks_down_draws_no_box_without_an_end(self):
        cos, sin = np.cos(0.2), np.sin(0.2)
        tilted = np.array([[1, 0, 0, 0], [0, cos, -sin, 0], [0, sin, cos, 0], [0, 0, 0, 1.0]]) @ AHEAD
        assert drawn_on(panel_of(truth_of(box(12, 0, h=np.inf)), camera=make_camera(tilted)))[0].size == 0


class TestCanvas:
    def test_a_line_that_leaves_the_picture_on_both_sides_crosses_all_of_it(self):
        picture = np.zeros((9, 20, 3), np.uint8)
        draw_segments(picture, [[(-1e12, 4.5), (1e12, 4.5)]], (255, 255, 255))
        assert picture[4, 1:].min() > 200
        assert picture[[0, 1, 7, 8]].max() == 0

    def test_a_slanted_line_keeps_its_slope_when_it_is_cut(self):
        picture = np.zeros((101, 101, 3), np.uint8)
        draw_segments(picture, [[(-1e7, -1e7), (1e7, 1e7)]], (255, 255, 255))
        assert picture[np.arange(101), np.arange(101)].min() > 150


class TestBirdEyeView:
    """512 pixels for 102.4 m: five pixels a metre; the ego stands at (256, 256)."""

    def view(self, *marks, maps=None):
        return draw_bird_eye_view(list(marks), maps or {}, range_m=51.2, size_px=512, scale=1.0)

    def drawn_on(self, *marks, maps=None):
        return difference(self.view(*marks, maps=maps), self.view())

    def test_a_box_ahead_on_the_left_is_up_on_the_left(self):
        # x = 20, y = 10: u = (51.2 - 10) * 5 = 206, v = (51.2 - 20) * 5 = 156; 2 m wide, 4 m long upwards.
        rows, columns = self.drawn_on(truth_of(box(20, 10)))
        assert (rows.min(), rows.max()) == (145, 166)
        assert (columns.min(), columns.max()) == (200, 211)

    @pytest.mark.parametrize(
        ("yaw", "front", "rear"),
        [(0.0, (151, 206), (161, 206)), (np.pi / 2, (156, 201), (156, 211))],
    )
    def test_the_heading_line_runs_from_the_middle_to_the_front(self, yaw, front, rear):
        green = self.view(truth_of(box(20, 10, yaw=yaw)))[..., 1]
        assert green[front] > 100
        assert green[rear] < 100

    def test_the_arrow_ends_where_the_box_will_be_in_a_second(self):
        # 6 m/s to the left: from u = 206 to 176.
        rows, columns = self.drawn_on(truth_of(box(20, 10, vy=6.0)))
        assert columns.min() in (175, 176)
        assert rows[columns == columns.min()].mean() == 155.5

    def test_a_velocity_that_is_not_known_has_no_arrow(self):
        standing, unknown = truth_of(box(20, 10)), truth_of(box(20, 10, vx=np.nan, vy=np.nan))
        np.testing.assert_array_equal(self.view(unknown), self.view(standing))

    def test_rings_are_ten_metres_apart(self):
        # Straight to the left of the ego, clear of the words: columns 206, 156, 106, 56, 6.
        brightness = self.view()[256, :230].astype(int).sum(axis=1)
        ring = np.nonzero(brightness > brightness.min() + 60)[0]
        expected = np.array([6, 56, 106, 156, 206])
        assert {int(np.argmin(np.abs(expected + 0.0 - column))) for column in ring} == set(range(5))
        assert all(np.abs(expected - (column + 0.5)).min() <= 1 for column in ring)

    def test_the_ego_points_up(self):
        white = (self.view() == 240).all(axis=2)
        rows, columns = np.nonzero(white)
        assert (rows < 256).sum() > 2 * (rows >= 256).sum()
        assert abs(columns.mean() + 0.5 - 256) < 1

    def test_a_map_cell_far_ahead_on_the_left_is_tinted_up_on_the_left(self):
        # 16 x 16 cells of 32 pixels: i = 15 is the farthest ahead, j = 12 the fourth from the left.
        mask = np.zeros((16, 16), bool)
        mask[15, 12] = True
        rows, columns = self.drawn_on(maps={"drivable_area": mask})
        assert (rows.min(), rows.max()) == (0, 31)
        assert (columns.min(), columns.max()) == (96, 127)

    def test_half_a_probability_tints_half_as_much(self):
        ground, half, full = (
            self.view(maps={"drivable_area": np.full((4, 4), value)})[3, 3].astype(float) for value in (0.0, 0.5, 1.0)
        )
        np.testing.assert_allclose(half, (ground + full) / 2, atol=1)
        assert np.abs(full - ground).max() > 20

    def test_a_box_out_of_range_draws_nothing(self):
        assert self.drawn_on(truth_of(box(80, 10)))[0].size == 0


class TestLayout:
    def test_nuscenes_cameras_stand_as_they_look(self):
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
    def test_other_rigs_stand_in_two_rows_at_most(self, azimuths, rows):
        assert camera_rows({azimuth: looking(azimuth) for azimuth in azimuths}) == rows

    def test_panels_keep_the_shape_of_their_cameras_and_do_not_overlap(self):
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

    def test_a_lost_camera_has_a_dark_panel_that_says_so(self):
        boxes = box(12, 0)
        seen = draw_frame(surround_frame(), boxes, ["car"])
        picture = draw_frame(surround_frame(lost=["CAM_FRONT"]), boxes, ["car"])
        panel = picture[30:340, 612:1210]
        assert panel.mean() < 30
        rows, columns = np.nonzero(panel.max(axis=2) > 100)
        assert abs(rows.mean() + 30 - 170) < 10
        assert abs(columns.mean() + 612 - 910) < 10
        np.testing.assert_array_equal(picture[:340, :604], seen[:340, :604])

    def test_a_rig_without_cameras_still_has_a_bird_eye_view(self):
        picture = draw_frame(make_frame({}, {}), box(20, 10), ["car"], height_px=360)
        assert picture.shape[0] == 360

    @pytest.mark.parametrize("height_px", [240, 720, 1440])
    def test_the_picture_has_the_height_that_was_asked_for(self, height_px):
        picture = draw_frame(surround_frame(), box(12, 0), ["tram"], [0.5], height_px=height_px)
        assert picture.shape[0] == height_px
        assert picture.shape[1] % 2 == 0

    def test_drawing_leaves_the_images_alone(self):
        frame = surround_frame()
        draw_frame(frame, box(12, 0), ["car"])
        assert all((image == image[0, 0]).all() for image in frame.images.values())

    def test_as_many_classes_and_scores_as_boxes_are_wanted(self):
        with pytest.raises(ValueError, match="1 boxes, 2 classes"):
            draw_frame(surround_frame(), box(12, 0), ["car", "bus"])
        with pytest.raises(ValueError, match="1 classes and 2 scores"):
            draw_frame(surround_frame(), box(12, 0), ["car"], [0.1, 0.2])


class TestCaption:
    def test_it_tells_scene_token_and_number_of_boxes(self):
        assert caption(surround_frame(), 1, None, None).split() == ["s", "t", "1", "box"]

    def test_it_tells_the_time_since_the_start_and_the_number_of_true_boxes(self):
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


class TestPng:
    def test_a_written_picture_is_read_back_the_same(self, tmp_path):
        picture = np.random.default_rng(0).integers(0, 256, (7, 5, 3), dtype=np.uint8)
        write_png(tmp_path / "a.png", picture)
        np.testing.assert_array_equal(cv2.imread(str(tmp_path / "a.png")), picture)
        assert [path.name for path in tmp_path.iterdir()] == ["a.png"]

    def test_a_picture_that_cannot_be_written_is_refused_by_its_path(self, tmp_path):
        with pytest.raises(OutputError, match=r"missing/a\.png") as refused:
            write_png(tmp_path / "missing" / "a.png", np.zeros((4, 4, 3), np.uint8))
        assert refused.value.exit_code == 5
