"""The pictures of a rig: what lies where in them, by the pinhole's own sums."""

import numpy as np
import pytest

from duospacenet.drawing import footer
from duospacenet.drawing.canvas import text_width_px, wrap_text
from duospacenet.drawing.coverage_map import (
    COUNT_COLOURS,
    SIZE_PX,
    GroundCoverage,
    Wedge,
    draw_counts,
    draw_coverage_map,
)
from duospacenet.drawing.footer import legend_bar, text_bar
from duospacenet.drawing.ground_view import (
    CROP_COLOUR,
    FORWARD_COLOUR,
    GRID_COLOUR,
    HORIZON_COLOUR,
    LEFT_COLOUR,
    RING_COLOUR,
    draw_ground_view,
)
from duospacenet.jobs.sources import open_recording
from duospacenet.rig import RigRequirements, examine
from duospacenet.rig.overlays import cut_corners, draw_camera_overlay, draw_rig_coverage, overlay_paths, wedge
from tests.helpers.rigs import UPPER_HALF_CUT, change_extrinsics, change_intrinsics, level_camera, write_rig

WHITE = (255, 255, 255)


def view_of(camera, **changes):
    """A camera's panel, black but for what is drawn: 160x80 px become 1280x640, with f = 640 px."""
    panel = draw_ground_view("", camera, np.zeros((80, 160, 3), np.uint8), [], **changes)
    return panel[:640]


def colour_at(picture, u, v):
    """The colour of the pixel that a point lies in."""
    return tuple(picture[int(v), int(u)].tolist())


# From 1.5 m above the origin: u = 640 - 640 y / x, v = 320 + 960 / x.
class TestTheGroundInACamera:
    def test_the_forward_axis_runs_down_the_middle_of_a_camera_that_looks_ahead(self):
        assert colour_at(view_of(level_camera(0)), 640, 320 + 960 / 15) == FORWARD_COLOUR

    def test_the_left_axis_does_so_in_one_that_looks_left_and_none_in_one_that_looks_right(self):
        assert colour_at(view_of(level_camera(90)), 640, 320 + 960 / 15) == LEFT_COLOUR
        right = view_of(level_camera(-90))
        assert not (right == LEFT_COLOUR).all(axis=2).any()
        assert not (right == FORWARD_COLOUR).all(axis=2)[:, 300:1000].any()

    def test_forward_is_on_the_right_of_a_camera_that_looks_half_left(self):
        # The point (15, 0) lies 45 degrees to the right, on the border; seen from 30 degrees left it is at
        # u = 640 + 640 tan 30 = 1009.5, at depth 15 cos 30.
        panel = view_of(level_camera(30))
        u, v = 640 + 640 * np.tan(np.radians(30)), 320 + 960 / (15 * np.cos(np.radians(30)))
        assert colour_at(panel, u, v) == FORWARD_COLOUR
        assert colour_at(panel, 1280 - u, v) != FORWARD_COLOUR

    def test_a_point_of_a_grid_line_has_the_grids_colour(self):
        panel = view_of(level_camera(0))
        assert colour_at(panel, 640 - 640 * 10 / 25, 320 + 960 / 25) == GRID_COLOUR  # (25, 10), on y = 10
        assert colour_at(panel, 640 - 640 * 3 / 10, 320 + 960 / 10) == GRID_COLOUR  # (10, 3), on x = 10
        assert colour_at(panel, 640 - 640 * 3 / 7, 320 + 960 / 7) == (0, 0, 0)  # (7, 3), on nothing

    def test_a_ring_goes_through_eight_ahead_and_six_to_the_side(self):
        panel = view_of(level_camera(0))
        for y in (6, -6):
            assert colour_at(panel, 640 - 640 * y / 8, 320 + 960 / 8) == RING_COLOUR

    def test_rings_are_around_the_ego_and_not_around_the_camera(self):
        # From 2 m ahead, 10 m from the origin is 8 m from the camera; a bit beside the axis.
        panel = view_of(level_camera(0, (2.0, 0, 1.5)))
        u, v = 640 - 640 * 0.4 / 7.992, 320 + 960 / 7.992
        assert colour_at(panel, u, v) == RING_COLOUR

    def test_the_horizon_of_a_level_camera_is_level_and_nothing_is_drawn_above_it(self):
        panel = view_of(level_camera(0))
        assert colour_at(panel, 100, 320) == colour_at(panel, 1200, 320) == HORIZON_COLOUR
        assert not panel[40:317].any()

    def test_the_horizon_of_a_camera_that_looks_up_sinks(self):
        # Up by atan(1/4): the horizon is 640 / 4 px below the middle.
        cos, sin = 4 / np.sqrt(17), 1 / np.sqrt(17)
        up = level_camera(0)
        turn = np.array([[1, 0, 0, 0], [0, cos, sin, 0], [0, -sin, cos, 0], [0, 0, 0, 1]])
        panel = view_of(level_camera(0, camera_T_ego=turn @ up.camera_T_ego))
        assert colour_at(panel, 100, 480) == HORIZON_COLOUR
        assert not panel[40:470].any()

    def test_a_lost_camera_and_wild_numbers_are_drawn_without_an_exception(self):
        lost = draw_ground_view("FRONT", level_camera(0), None, [])
        assert colour_at(lost, 640, 384) == FORWARD_COLOUR
        for wild in (np.zeros((4, 4)), np.full((4, 4), 1e300), level_camera(0).camera_T_ego * 1e200):
            draw_ground_view("FRONT", level_camera(0, camera_T_ego=wild), None, [])
        draw_ground_view("FRONT", level_camera(0, intrinsics_px=np.full((3, 3), 1e308)), None, [])
        draw_ground_view("FRONT", level_camera(0, width_px=10**9, height_px=1), None, [])

    def test_what_the_network_cuts_off_lies_outside_of_the_frame(self):
        # 160x80 is halved and the upper half of it cut: the frame's upper side is the picture's middle row.
        corners = cut_corners(level_camera(0), UPPER_HALF_CUT)
        np.testing.assert_allclose(corners, [(0, 40), (160, 40), (160, 80), (0, 80)])
        panel = view_of(level_camera(0), crop=corners)
        assert colour_at(panel, 100, 320) == colour_at(panel, 0, 500) == CROP_COLOUR
        assert not (panel[40:310] == CROP_COLOUR).all(axis=2).any()


class TestTheMap:
    def test_a_cell_ahead_on_the_left_is_painted_up_on_the_left(self):
        count = np.zeros((4, 2), int)  # x in [-4, 4] by 2 m, y in [-1, 3] by 2 m
        count[3, 1] = 2  # x in [2, 4], y in [1, 3]
        picture = draw_counts(GroundCoverage(count, (-4.0, -1.0), (4.0, 3.0)), 4.0, 80)  # 10 px a metre
        painted = (picture == COUNT_COLOURS["2"]).all(axis=2)
        rows, columns = np.nonzero(painted)
        assert (rows.min(), rows.max(), columns.min(), columns.max()) == (0, 19, 10, 29)
        assert painted.sum() == 400
        assert (picture == COUNT_COLOURS["0"]).all(
            axis=2
        ).sum() == 80 * 40 - 400  # beyond y = -1 and y = 3 lies nothing

    def test_more_than_three_cameras_look_like_three(self):
        picture = draw_counts(GroundCoverage(np.array([[1, 3], [0, 7]]), (-1.0, -1.0), (1.0, 1.0)), 1.0, 2)
        # Row 0 is ahead: the cells [1, :]; column 0 is left: the cells [:, 1].
        expected = [[COUNT_COLOURS["3+"], COUNT_COLOURS["0"]], [COUNT_COLOURS["3+"], COUNT_COLOURS["1"]]]
        assert picture.tolist() == [[list(colour) for colour in row] for row in expected]

    @pytest.mark.parametrize("azimuth_deg", [0, 90, 180, -60])
    def test_a_wedge_opens_where_the_camera_looks(self, azimuth_deg):
        found = wedge("a", level_camera(azimuth_deg, (1.0, 0.5, 1.5)))
        angles = np.degrees([found.left_rad, found.middle_rad, found.right_rad]) - azimuth_deg
        np.testing.assert_allclose((angles + 180) % 360 - 180, [45, 0, -45], atol=1e-9)
        np.testing.assert_allclose(found.position_m, [1.0, 0.5])

    def test_the_borders_of_a_wedge_are_drawn_to_the_left_for_a_camera_that_looks_left(self):
        wedges = [Wedge("x", np.zeros(2), *np.radians([135, 90, 45]))]
        ground = GroundCoverage(np.zeros((2, 2), int), (-50.0, -50.0), (50.0, 50.0))
        colour = np.array([255, 165, 64])
        picture = draw_coverage_map(ground, wedges, [])[:SIZE_PX]
        is_wedge = (np.abs(picture.astype(int) - colour) < 8).all(axis=2)
        # 10 px a metre, middle at 500: 10 m out on both borders, 25 m out in the middle.
        for row, column in ((400, 400), (600, 400), (500, 250)):
            assert is_wedge[row - 1 : row + 2, column - 1 : column + 2].any()
        assert not is_wedge[:, 520:].any()

    def test_names_of_cameras_that_look_alike_do_not_lie_on_each_other(self):
        ground = GroundCoverage(np.zeros((2, 2), int), (-50.0, -50.0), (50.0, 50.0))
        one = [Wedge("A" * 20, np.zeros(2), 0.7, 0.0, -0.7)]
        both = [*one, Wedge("B" * 20, np.zeros(2), 0.7, 0.0, -0.7)]
        without = draw_coverage_map(ground, one, [])
        rows, _ = np.nonzero((draw_coverage_map(ground, both, []) != without).any(axis=2))
        name_rows = np.nonzero((without[:248] != draw_coverage_map(ground, [], [])[:248]).any(axis=2))[0]
        beyond = rows[rows < name_rows.min()]
        assert len(beyond) > 0  # the second name is farther out than the first


class TestTheWordsBelow:
    def test_no_line_is_wider_than_its_room_and_no_word_is_lost(self):
        text = "expected a camera above the road; got " + "x" * 300 + " and more"
        lines = wrap_text(text, 15, 400)
        assert all(text_width_px(line, 15) <= 400 for line in lines)
        assert "".join(lines).replace(" ", "") == text.replace(" ", "")
        assert wrap_text("two words", 15, 400) == ["two words"]

    def test_a_bar_is_as_high_as_its_lines_need(self):
        one, three = text_bar([("a", WHITE)], 300), text_bar([("a", WHITE), ("b", WHITE), ("c", WHITE)], 300)
        assert one.shape[1] == three.shape[1] == 300
        assert three.shape[0] - one.shape[0] == 48

    def test_nothing_is_written_up_to_the_border_of_a_bar(self):
        for bar in (
            text_bar([("Wg" * 100, WHITE)], 200),
            legend_bar({f"a name {i}": WHITE for i in range(9)} | {"W" * 60: WHITE}, 200),
        ):
            background = bar[0, 0]
            for border in (bar[:, :2], bar[:, -2:], bar[:2], bar[-2:]):
                assert (border == background).all()

    def test_a_long_name_stays_in_its_panel(self):
        panel = draw_ground_view("W" * 200, level_camera(0), None, [])
        assert (panel[:5, -4:] == panel[50, -4:]).all()


class TestFileNames:
    def test_odd_names_stay_in_the_folder_and_apart(self):
        names = ["FRONT", "front", "../../etc/passwd", "a/b", "a b", "", ".", "Кам", "x" * 500, "CON.png"]
        paths = overlay_paths(names)
        assert paths["FRONT"] == "cameras/FRONT.png"
        assert paths["../../etc/passwd"] == "cameras/______etc_passwd.png"
        assert len({path.lower() for path in paths.values()}) == len(names)
        for path in paths.values():
            assert path.startswith("cameras/")
            assert path.count("/") == path.count(".") == 1
            assert len(path) < 120


def test_the_picture_of_a_broken_camera_says_why(tmp_path, monkeypatch):
    written = []
    monkeypatch.setattr(footer, "draw_text", lambda picture, text, *_: written.append(text))
    folder = write_rig(tmp_path / "rig", change_extrinsics("FRONT", np.linalg.inv))
    examination = examine(open_recording(str(folder)), RigRequirements(), 1)
    words = " ".join(finding.cause for finding in examination.views["FRONT"].findings)
    assert "ego_T_camera" in words
    draw_camera_overlay("FRONT", examination)
    assert "broken, frame 0: looks " in " ".join(written)
    assert words in " ".join(written)
    written.clear()
    draw_camera_overlay("LEFT", examination)
    assert "ok, frame 0: looks 90.0 degrees to the left" in " ".join(written)
    assert "ego_T_camera" not in " ".join(written)


def test_the_bar_of_a_broken_camera_has_room_for_its_words(tmp_path):
    folder = write_rig(tmp_path / "rig", change_extrinsics("FRONT", np.linalg.inv))
    examination = examine(open_recording(str(folder)), RigRequirements(), 1)
    heights = {name: draw_camera_overlay(name, examination).shape[0] for name in examination.views}
    assert heights["FRONT"] >= heights["LEFT"] + 24
    assert heights["LEFT"] == heights["BACK"]
    assert draw_rig_coverage(examination).shape[1] == SIZE_PX


def test_the_map_of_a_rig_without_a_sound_camera_is_drawn(tmp_path):
    def all_broken(scene):
        for name in scene["cameras"]:
            change_intrinsics(name, np.transpose)(scene)

    examination = examine(open_recording(str(write_rig(tmp_path / "rig", all_broken))), RigRequirements(), 1)
    assert colour_at(draw_rig_coverage(examination), 3, 3) == COUNT_COLOURS["0"]
