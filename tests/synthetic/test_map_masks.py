"""Map masks: the cells of outlines, and the masks of a drive."""

import numpy as np
import pytest

from duospacenet.runtime.geometry import image_T_ego, project
from duospacenet.synthetic.drive import SyntheticDrive
from duospacenet.synthetic.map_masks import cells_with_centre_inside


@pytest.fixture(scope="module")
def drive() -> SyntheticDrive:
    return SyntheticDrive(7, frames=6)


def test_the_cells_of_a_mask_are_counted_forward_and_to_the_left():
    outline = np.array([[10.0, 5.0], [20.0, 5.0], [20.0, 8.0], [10.0, 8.0]])
    mask = cells_with_centre_inside([outline], (200, 200))
    for i in range(200):
        for j in range(200):
            x, y = -51.2 + (i + 0.5) * 0.512, -51.2 + (j + 0.5) * 0.512
            if min(abs(x - 10), abs(x - 20), abs(y - 5), abs(y - 8)) > 0.08:
                assert mask[i, j] == (10 < x < 20 and 5 < y < 8)


def test_more_road_is_on_the_left_because_traffic_keeps_to_the_right(drive):
    for index in range(len(drive)):
        road = drive.frame(index).ground_truth.maps["drivable_area"]
        assert road.shape == (200, 200)
        assert road.dtype == bool
        beside = road[95:105]
        assert beside[:, 100:].sum() > beside[:, :100].sum() + 10


@pytest.mark.parametrize("seed", [0, 1, 2, 7])
def test_drivable_cells_have_the_colour_of_asphalt_and_other_cells_do_not(seed):
    drive = SyntheticDrive(seed, frames=2, image_size=(800, 320))
    key_frame, road = drive.key_frame(1), drive.frame(1).ground_truth.maps["drivable_area"]
    centre = -51.2 + (np.arange(200) + 0.5) * 0.512
    points = np.stack([*np.meshgrid(centre, centre, indexing="ij"), np.zeros((200, 200))], axis=-1)
    inner = road & np.roll(road, 1, 0) & np.roll(road, -1, 0) & np.roll(road, 1, 1) & np.roll(road, -1, 1)
    road_colours, other_colours = [], []
    for name, rendered in drive.render(key_frame).items():
        camera = drive.cameras[name]
        pixels, depth = project(points, image_T_ego(camera.intrinsics_px, camera.camera_T_ego))
        inside = ((pixels > 0) & (pixels < (800, 320))).all(axis=-1) & (depth > 1) & (depth < 22)
        u, v = np.where(inside[..., None], pixels, 0).astype(int).transpose(2, 0, 1)
        free = inside & (rendered.ids[v, u] == 0)
        road_colours.append(rendered.image[v, u][free & inner])
        other_colours.append(rendered.image[v, u][free & ~road])
    on_road, off_road = np.concatenate(road_colours), np.concatenate(other_colours)
    road_is_green, other_is_green = greenness(on_road) > 1.15, greenness(off_road) > 1.15
    assert len(on_road) > 300
    assert road_is_green.mean() < 0.01
    assert other_is_green.mean() > 0.2
    assert np.median(off_road[~other_is_green]) > 1.15 * np.median(on_road)  # the sidewalk


def greenness(colours: np.ndarray) -> np.ndarray:
    """The ratio of green to the mean of blue and red; 0 for the yellow of the centre line."""
    blue, green, red = colours.astype(np.float64).T + 1
    return np.where(red > 1.15 * green, 0.0, green / ((blue + red) / 2))


def test_lane_boundaries_are_on_the_road_and_thin(drive):
    for frame in drive:
        lines, road = frame.ground_truth.maps["lane_boundary"], frame.ground_truth.maps["drivable_area"]
        grown = road | np.roll(road, 1, 0) | np.roll(road, -1, 0) | np.roll(road, 1, 1) | np.roll(road, -1, 1)
        assert lines.any()
        assert not (lines & ~grown).any()
        assert lines.sum() < 0.5 * road.sum()


def test_lane_boundaries_follow_the_rendered_centre_line():
    drive = SyntheticDrive(7, frames=1)
    key_frame = drive.key_frame(0)
    mask = drive.frame(0).ground_truth.maps["lane_boundary"]
    lines = [outline for kind, outline in key_frame.ground if kind == "yellow"][:2]  # on either side of the middle
    middle = (lines[0] + lines[1]) / 2
    cells = np.floor((middle[(np.abs(middle) < 51).all(axis=1)] + 51.2) / 0.512).astype(int)
    assert len(cells) > 20
    assert mask[cells[:, 0], cells[:, 1]].mean() > 0.9
