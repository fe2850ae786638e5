"""The map expansion of a root: the streets of every scene, at their place in the global frame."""

import json

import cv2
import numpy as np
import pytest

from duospacenet.synthetic.nuscenes_root.map_layout import LOCATIONS, MapLayout
from tests.helpers.nuscenes_roots import pose

POLYGON_LAYERS = ("road_segment", "road_block", "lane", "ped_crossing", "walkway", "carpark_area")
LINE_LAYERS = ("road_divider", "lane_divider")


class Map:
    """A map expansion file, read with the json module alone."""

    def __init__(self, root, location):
        self.layers = json.loads((root / "maps" / "expansion" / f"{location}.json").read_text())
        self.nodes = {node["token"]: (node["x"], node["y"]) for node in self.layers["node"]}
        self.polygons = {row["token"]: row["exterior_node_tokens"] for row in self.layers["polygon"]}
        self.lines = {row["token"]: row["node_tokens"] for row in self.layers["line"]}

    def points(self, tokens) -> np.ndarray:
        return np.array([self.nodes[token] for token in tokens])

    def drivable_outlines(self) -> list[np.ndarray]:
        tokens = [token for row in self.layers["drivable_area"] for token in row["polygon_tokens"]]
        return [self.points(self.polygons[token]) for token in tokens]


@pytest.fixture(scope="module")
def maps(tables):
    return {row["location"]: Map(tables.root, row["location"]) for row in tables.rows["log"]}


def location_of(tables, sample):
    scene = tables.get("scene", sample["scene_token"])
    return tables.get("log", scene["log_token"])["location"]


def ego_position(tables, sample):
    data = tables.data_of(sample)["LIDAR_TOP"]
    return tables.get("ego_pose", data["ego_pose_token"])["translation"][:2]


def is_inside(outlines, point) -> bool:
    return any(cv2.pointPolygonTest(outline.astype(np.float32), point, False) > 0 for outline in outlines)


def test_every_location_has_a_file_of_version_1_3_with_links_that_lead_to_records(tables, maps):
    assert len(maps) == len(list((tables.root / "maps" / "expansion").iterdir())) == 2
    for location, each in maps.items():
        layers = each.layers
        assert location in LOCATIONS
        assert layers["version"] == "1.3"
        for layer in POLYGON_LAYERS:
            assert layers[layer] and all(row["polygon_token"] in each.polygons for row in layers[layer]), layer
        for layer in LINE_LAYERS:
            assert layers[layer] and all(row["line_token"] in each.lines for row in layers[layer]), layer
        for tokens in (*each.polygons.values(), *each.lines.values()):
            assert all(token in each.nodes for token in tokens)
        assert all(len(tokens) >= 3 for tokens in each.polygons.values())


def test_all_positions_are_on_the_canvas(maps):
    for each in maps.values():
        points = np.array(list(each.nodes.values()))
        assert np.all(points > 0) and np.all(points < each.layers["canvas_edge"])


def test_the_ego_drives_on_the_drivable_area_in_every_sample_and_stands_beside_it_nowhere(tables, maps):
    for sample in tables.rows["sample"]:
        outlines = maps[location_of(tables, sample)].drivable_outlines()
        assert is_inside(outlines, ego_position(tables, sample))


def test_vehicles_are_on_the_drivable_area_and_people_of_the_sidewalk_are_not(tables, maps):
    inside = {"vehicle.car": [], "human.pedestrian.adult": []}
    for sample in tables.rows["sample"][::3]:
        outlines = maps[location_of(tables, sample)].drivable_outlines()
        for annotation in tables.annotations_of(sample):
            if (category := tables.category(annotation)) in inside:
                inside[category].append(is_inside(outlines, annotation["translation"][:2]))
    assert all(inside["vehicle.car"]) and len(inside["vehicle.car"]) > 20
    assert np.mean(inside["human.pedestrian.adult"]) < 0.3  # workers of roadworks, and people who cross a street


def test_the_lines_of_the_map_are_where_the_images_show_yellow_and_white_paint(tables, maps):
    """Bright pixels along the projected lines, and dark asphalt beside them."""
    on_line, beside = [], []
    for sample in tables.rows["sample"][1:4]:
        each = maps[location_of(tables, sample)]
        data = tables.data_of(sample)["CAM_BACK"]
        image = cv2.imread(str(tables.root / data["filename"])).max(axis=2)
        calibrated = tables.get("calibrated_sensor", data["calibrated_sensor_token"])
        camera_T_global = np.linalg.inv(pose(tables.get("ego_pose", data["ego_pose_token"])) @ pose(calibrated))
        for row in each.layers["road_divider"]:
            line = each.points(each.lines[row["line_token"]])
            direction = (line[1] - line[0]) / np.linalg.norm(line[1] - line[0])
            left = np.array([-direction[1], direction[0]])
            steps = np.linspace(line[:-1], line[1:], 20)[:-1].reshape(-1, 2)
            for across, found in ((0.17, on_line), (-0.17, on_line), (0.9, beside), (-0.9, beside)):
                points = np.column_stack([steps + across * left, np.zeros(len(steps)), np.ones(len(steps))])
                camera = (points @ camera_T_global.T)[:, :3]
                camera = camera[(camera[:, 2] > 4) & (camera[:, 2] < 12)]
                u, v, _ = (camera @ np.array(calibrated["camera_intrinsic"]).T / camera[:, 2:]).T
                is_in = (u > 0) & (u < image.shape[1]) & (v > 0) & (v < image.shape[0])
                found += image[v[is_in].astype(int), u[is_in].astype(int)].tolist()
    assert len(on_line) > 50 and len(beside) > 50
    assert np.median(on_line) > np.median(beside) + 30


def test_the_scenes_of_a_map_do_not_overlap():
    layout = MapLayout()
    places = [layout.place(number, number, 40) for number in range(40)]
    for location in LOCATIONS:
        bounds = []
        for place in (place for place in places if place.location == location):
            points = np.concatenate([patch.outline for patch in place.road.ground_patches(*place.ends_m)])
            bounds.append([*(points.min(axis=0) + place.origin_m), *(points.max(axis=0) + place.origin_m)])
        assert len(bounds) == 10
        for number, (x0, y0, x1, y1) in enumerate(bounds):
            assert x0 > 49 and y0 > 49
            assert x1 < layout.canvas_m(location)[0] and y1 < layout.canvas_m(location)[1]
            for a0, b0, a1, b1 in bounds[:number]:
                assert x1 < a0 or a1 < x0 or y1 < b0 or b1 < y0
