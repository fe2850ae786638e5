"""Annotations form tracks: with frames without points, with gaps, and with ends."""

from collections import Counter

import numpy as np
import pytest

from duospacenet.synthetic.nuscenes_root.annotated_object import AnnotatedObject
from duospacenet.synthetic.nuscenes_root.object_attributes import choose_attribute
from duospacenet.synthetic.nuscenes_root.root_tables import RootTables, visibility_token
from duospacenet.synthetic.nuscenes_root.tracks import Tracks


def annotated(num_points=1, category="vehicle.car", speed=0.0) -> AnnotatedObject:
    return AnnotatedObject((1, 2), category, np.array([5, 6, 1, 2, 4, 1.5, 0.5, speed, 0]), 0.7, num_points, 0)


def add_track(folder, points_by_frame: list[int | None]) -> RootTables:
    """The tables of one object; None for a frame in which it is not near the ego."""
    tracks, tables = Tracks(seed=0, name="scene-0061"), RootTables(folder)
    for index, num_points in enumerate(points_by_frame):
        tracks.add_frame(index, [] if num_points is None else [annotated(num_points)])
    tracks.add_rows(tables, [f"sample {index}" for index in range(len(points_by_frame))])
    return tables


@pytest.mark.parametrize(
    ("points_by_frame", "annotated_frames"),
    [
        ([1, 2, 3], [0, 1, 2]),
        ([0, 5, 0, 0, 0, 5, 0], [1, 2, 3, 4, 5]),  # three frames without points are bridged
        ([5, 0, 0, 0, 0, 5], [0, 5]),  # four are not
        ([5, None, 0, 5], [0, 2, 3]),
        ([0, 0, 7, 0], [2]),
        ([0, 0], []),
    ],
)
def test_an_object_is_annotated_from_its_first_to_its_last_point_without_long_gaps(
    tmp_path, points_by_frame, annotated_frames
):
    tables = add_track(tmp_path, points_by_frame)
    rows = tables.rows["sample_annotation"]
    assert [row["sample_token"] for row in rows] == [f"sample {index}" for index in annotated_frames]
    assert [row["num_lidar_pts"] for row in rows] == [points_by_frame[index] for index in annotated_frames]
    assert len(tables.rows["instance"]) == bool(annotated_frames)


def test_the_root_has_annotations_without_points_and_tracks_of_one_frame(tables):
    annotations = tables.rows["sample_annotation"]
    assert 5 < sum(row["num_lidar_pts"] + row["num_radar_pts"] == 0 for row in annotations) < len(annotations) / 4
    assert sum(row["nbr_annotations"] == 1 for row in tables.rows["instance"]) > 5  # without a velocity


def test_boxes_move_between_frames_with_the_speed_of_traffic_or_not_at_all(tables):
    speeds = Counter()
    for row in tables.rows["sample_annotation"]:
        following = tables.by_token["sample_annotation"].get(row["next"])
        attributes = tables.attributes(row)
        if following is None or not attributes:
            continue
        times = [tables.get("sample", each["sample_token"])["timestamp"] * 1e-6 for each in (row, following)]
        moved = np.linalg.norm(np.subtract(following["translation"], row["translation"]))
        speed = moved / (times[1] - times[0])
        assert speed < 17
        speeds[attributes[0], bool(speed > 0.2)] += 1
    assert speeds["vehicle.moving", True] > 50
    assert speeds["vehicle.parked", False] > 10
    assert speeds["vehicle.stopped", False] > 3
    assert speeds["vehicle.parked", True] == speeds["cycle.without_rider", True] == 0


def test_attributes_do_not_follow_from_the_speed_alone():
    def attributes(category, speed):
        return Counter(choose_attribute(annotated(1, category, speed), np.random.default_rng(n)) for n in range(400))

    stationary = attributes("vehicle.car", 0.0)
    assert set(stationary) == {"vehicle.parked", "vehicle.stopped", ""}
    assert stationary["vehicle.parked"] > 2 * stationary["vehicle.stopped"] > 10 * stationary[""]
    assert attributes("vehicle.truck", 5.0).most_common(1)[0][0] == "vehicle.moving"
    assert set(attributes("human.pedestrian.adult", 0.0)) >= {"pedestrian.standing", "pedestrian.sitting_lying_down"}
    assert set(attributes("vehicle.bicycle", 4.0)) == {"cycle.with_rider", ""}
    assert set(attributes("movable_object.barrier", 0.0)) == {""}


@pytest.mark.parametrize(("share", "token"), [(0.0, "1"), (0.4, "1"), (0.41, "2"), (0.7, "3"), (0.81, "4"), (1.0, "4")])
def test_visibility_has_four_levels(share, token):
    assert visibility_token(share) == token


def test_categories_of_no_class_and_several_of_one_class_occur(tables):
    categories = Counter(map(tables.category, tables.rows["sample_annotation"]))
    assert categories["human.pedestrian.adult"] and categories["human.pedestrian.child"]
    assert categories["vehicle.emergency.police"] and categories["static_object.bicycle_rack"]
    assert len(tables.rows["category"]) == 23
