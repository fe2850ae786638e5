"""Racks beside the street hold bicycles, which the detection benchmark leaves out."""

import numpy as np

from duospacenet.synthetic.nuscenes_root.bicycle_racks import racks_between
from duospacenet.synthetic.road import Road
from duospacenet.synthetic.world import World


def in_rack_frame(rack, points):
    """Points (n, 2) relative to the centre of a rack, in the direction of its length and to its left."""
    centre, yaw = rack.box()[:2], rack.box()[6]
    cos, sin = np.cos(yaw), np.sin(yaw)
    return (points - centre) @ np.array([[cos, -sin], [sin, cos]])


def test_every_bicycle_of_a_rack_is_inside_the_box_of_the_rack():
    racks = list(racks_between(3, Road(3, 300.0), 0.0, 300.0))
    assert len(racks) > 3
    for rack in racks:
        width, length = rack.box()[3:5]
        bicycles = rack.bicycles()
        assert set(bicycles.names) == {"bicycle"}
        along, across = in_rack_frame(rack, bicycles.boxes[:, :2]).T
        assert np.all(np.abs(along) < length / 2) and np.all(np.abs(across) < width / 2)
        assert np.all(np.diff(np.sort(along)) > bicycles.boxes[:, 4].max())  # they do not overlap


def test_racks_overlap_no_other_object_of_the_world():
    for seed in range(5):
        road = Road(seed, 100.0)
        objects = World(seed, road).snapshot(3.0)
        for rack in racks_between(seed, road, -50.0, 150.0):
            along, across = np.abs(in_rack_frame(rack, objects.boxes[:, :2])).T
            # The objects are parallel to the rack.
            is_beside = along < (rack.length_m + objects.boxes[:, 4]) / 2
            half_widths = (rack.bicycles().boxes[:, 3].max() + objects.boxes[is_beside, 3]) / 2
            assert np.all(across[is_beside] > half_widths), seed


def test_the_root_annotates_racks_with_bicycles_in_them(tables):
    found = 0
    for sample in tables.rows["sample"]:
        annotations = tables.annotations_of(sample)
        centres = np.array([row["translation"] for row in annotations if tables.category(row) == "vehicle.bicycle"])
        for row in annotations:
            if tables.category(row) == "static_object.bicycle_rack" and len(centres):
                yaw = 2 * np.arctan2(row["rotation"][3], row["rotation"][0])
                away = centres[:, :2] - row["translation"][:2]
                along = np.abs(away @ [np.cos(yaw), np.sin(yaw)])
                across = np.abs(away @ [-np.sin(yaw), np.cos(yaw)])
                found += np.count_nonzero((along < row["size"][1] / 2) & (across < row["size"][0] / 2))
    assert found > 10
