"""Anchors: centroids that can be worked out by hand, in the ego frame, and a file that is checked."""

import json
import signal

import cv2
import numpy as np
import pytest

from duospacenet.data.anchor_clustering import centres_within_range, cluster_centres, ground_truth_centres
from duospacenet.data.anchors_file import Anchors, check_new_file, read_anchors, write_anchors
from duospacenet.data.scene_folder import SceneFolder
from duospacenet.runtime.errors import ArtifactError, InputError, OutputError
from duospacenet.synthetic.drive import SyntheticDrive
from tests.data.test_scene_folder import AT_ORIGIN, SCENE, copy_of, write_yard

# Three groups, tens of metres apart, and the mean of each, worked out by hand.
GROUPS = {
    (20.0, 0.0, 1.0): [(19.0, -1.0, 0.5), (21.0, 1.0, 1.5)],
    (-10.0, 30.0, 0.5): [(-10.0, 30.0, 0.5)],
    (-30.0, -20.0, 2.0): [(-31.0, -20.0, 1.0), (-29.0, -21.0, 2.0), (-30.0, -19.0, 3.0)],
}
POINTS = np.array([point for group in GROUPS.values() for point in group])
RECORD = Anchors(
    schema_version=1,
    centres_m=((1.0, 2.0, 3.0), (4.5, -5.0, 0.0)),
    source="synthetic:1:2",
    num_frames=2,
    num_boxes=9,
    range_m=55.0,
    seed=3,
)


def in_order(points) -> np.ndarray:
    points = np.asarray(points, dtype=np.float64)
    return points[np.lexsort(points.T)]


def box(*centre_m):
    return {"class": "car", "center_m": centre_m, "size_wlh_m": [2, 4, 2], "yaw_rad": 0.3, "velocity_m_s": [1, 0]}


def yard_with_boxes(folder, boxes_of_frames, poses=(AT_ORIGIN, AT_ORIGIN)):
    """The yard, its two frames with these boxes and ego poses."""
    frames = copy_of(SCENE["frames"])
    for frame, boxes, pose in zip(frames, boxes_of_frames, poses, strict=True):
        frame.pop("boxes", None)
        frame["global_T_ego"] = pose
        if boxes is not None:
            frame["boxes"] = [box(*centre) for centre in boxes]
    return SceneFolder(write_yard(folder, frames=frames))


# --- Clusters -----------------------------------------------------------------------------------------------------


def test_centroids_of_well_separated_groups_are_the_groups_means():
    clusters = cluster_centres(POINTS, 3)
    np.testing.assert_allclose(in_order(clusters.centroids), in_order(list(GROUPS)), atol=1e-12)


def test_the_distance_is_the_root_mean_square_to_the_nearest_centroid():
    squares = [(1 + 1 + 0.25), (1 + 1 + 0.25), 0, (1 + 0 + 1), (1 + 1 + 0), (0 + 1 + 1)]
    assert cluster_centres(POINTS, 3).rms_distance_m == pytest.approx(np.sqrt(sum(squares) / 6))


def test_axes_count_in_metres_and_are_not_standardised():
    """Spread over 20 m in x, and 2 m apart in z: two clusters split x, though in standard deviations z is clearer."""
    points = np.array([[x, 0.0, z] for x in (0.0, 7.0, 13.0, 20.0) for z in (0.0, 2.0)])
    np.testing.assert_allclose(in_order(cluster_centres(points, 2).centroids), [[3.5, 0, 1], [16.5, 0, 1]])


def test_as_many_clusters_as_points_are_the_points():
    np.testing.assert_allclose(in_order(cluster_centres(POINTS, len(POINTS)).centroids), in_order(POINTS))


def test_centroids_are_a_function_of_the_seed_alone():
    points = np.random.default_rng(0).normal(0, 20, (500, 3))
    first, other, again = (cluster_centres(points, 40, seed).centroids for seed in (5, 6, 5))
    assert np.array_equal(first, again)
    assert not np.array_equal(in_order(first), in_order(other))


def test_points_that_are_all_alike_give_finite_centroids():
    np.testing.assert_array_equal(np.nan_to_num(cluster_centres(np.ones((8, 3)), 3).centroids, nan=-1), np.ones((3, 3)))


def test_one_box_is_the_one_centroid():
    """Its three numbers are not three points."""
    clusters = cluster_centres(np.array([[4.0, -5.0, 0.75]]), 1)
    assert clusters.centroids.tolist() == [[4.0, -5.0, 0.75]]
    assert clusters.rms_distance_m == 0


def test_the_best_of_several_starts_is_taken(monkeypatch):
    """The last sum of squares of each start is what OpenCV found for it; they differ, and the least one counts."""
    points = np.random.default_rng(0).normal(0, 20, (300, 3))
    starts, kmeans = [], cv2.kmeans

    def watched(*arguments):
        result = kmeans(*arguments)
        if arguments[-1] == cv2.KMEANS_PP_CENTERS:
            starts.append(result[0])
        starts[-1] = result[0]
        return result

    monkeypatch.setattr(cv2, "kmeans", watched)
    distance_m = cluster_centres(points, 30).rms_distance_m
    assert len(set(starts)) == 3
    assert distance_m == pytest.approx(np.sqrt(min(starts) / 300), rel=1e-5)


def test_it_settles_where_every_point_is_nearest_to_its_own_centroid():
    points = np.random.default_rng(1).normal(0, 20, (400, 3))
    centroids = cluster_centres(points, 12).centroids
    nearest = ((points[:, None] - centroids) ** 2).sum(axis=-1).argmin(axis=1)
    means = [points[nearest == index].mean(axis=0) for index in range(12)]
    np.testing.assert_allclose(centroids, means, atol=0.01)


@pytest.fixture
def interruptible():
    """Ctrl-C raises KeyboardInterrupt, whatever the process that runs the tests does with it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_an_interruption_is_heard_between_two_iterations(monkeypatch, interruptible):
    calls, iterate = [], cv2.kmeans

    def interrupted(points, num_clusters, labels, criteria, attempts, flags):
        calls.append((criteria[1], attempts))
        if len(calls) == 3:
            signal.raise_signal(signal.SIGINT)
        return iterate(points, num_clusters, labels, criteria, attempts, flags)

    monkeypatch.setattr(cv2, "kmeans", interrupted)
    with pytest.raises(KeyboardInterrupt):
        cluster_centres(np.random.default_rng(0).normal(0, 20, (500, 3)), 40)
    assert calls == [(2, 1)] * 3  # 2 is the fewest that OpenCV does


# --- The truth of a source ----------------------------------------------------------------------------------------


def test_centres_lie_in_the_ego_frame_however_the_ego_has_moved(tmp_path):
    moved = np.eye(4)
    moved[:2, :2] = [[0, -1], [1, 0]]
    moved[:3, 3] = (100.0, -40.0, 1.0)
    source = yard_with_boxes(tmp_path, [[(10, 0, 1)], [(12, 0, 1)]], (AT_ORIGIN, moved.tolist()))
    centres = list(ground_truth_centres(source, range(2)))
    assert [rows.tolist() for rows in centres] == [[[10, 0, 1]], [[12, 0, 1]]]
    np.testing.assert_allclose(cluster_centres(centres_within_range(centres, 1), 1).centroids, [[11, 0, 1]])


def test_a_drawn_drive_gives_the_boxes_of_its_frames():
    drive = SyntheticDrive(7, frames=3, image_size=(160, 64))
    centres = list(ground_truth_centres(drive, range(3)))
    for frame, rows in zip(drive, centres, strict=True):
        np.testing.assert_array_equal(rows, frame.ground_truth.boxes[:, :3])


def test_the_images_of_a_scene_folder_are_not_read(tmp_path):
    source = yard_with_boxes(tmp_path, [[(10, 0, 1)], None])
    for path in tmp_path.glob("*.png"):
        path.unlink()
    assert [rows.tolist() for rows in ground_truth_centres(source, range(2))] == [[[10, 0, 1]]]


def test_a_frame_without_truth_is_none_of_them_and_an_empty_one_is(tmp_path):
    for boxes, number in (([None, [(1, 1, 1)]], 1), ([[], [(1, 1, 1)]], 2), ([None, None], 0)):
        assert len(list(ground_truth_centres(yard_with_boxes(tmp_path, boxes), range(2)))) == number


def test_boxes_beyond_the_range_are_left_out_by_their_distance_in_three_dimensions():
    centres = [np.array([[30.0, 40.0, 0.0], [30.0, 40.0, 1.0]]), np.array([[-60.0, 0, 0]])]
    assert centres_within_range(centres, 1, 50.0).tolist() == [[30.0, 40.0, 0.0]]
    assert len(centres_within_range(centres, 1)) == 2


def test_fewer_boxes_than_queries_are_refused_with_both_numbers():
    centres = [np.arange(9.0).reshape(3, 3), np.full((2, 3), 99.0)]
    with pytest.raises(InputError, match=r"at least 4 true boxes within 55 m.*got 3 of 5 in 2 frames.*fewer queries"):
        centres_within_range(centres, 4)


def test_one_frame_is_not_one_frames():
    with pytest.raises(InputError, match="got 3 of 3 in 1 frame, each"):
        centres_within_range([np.eye(3)], 4)


def test_a_source_without_truth_is_refused():
    with pytest.raises(InputError, match=r"expected true boxes in the source; got none in any frame"):
        centres_within_range([], 4)


# --- The file -----------------------------------------------------------------------------------------------------


def test_what_is_written_is_read_again(tmp_path):
    write_anchors(tmp_path / "new" / "anchors.json", RECORD)
    assert read_anchors(tmp_path / "new" / "anchors.json") == RECORD
    assert RECORD.centres.tolist() == [[1.0, 2.0, 3.0], [4.5, -5.0, 0.0]]


def test_an_existing_file_is_kept(tmp_path):
    (tmp_path / "anchors.json").write_text("mine")
    with pytest.raises(OutputError, match="it exists already"):
        write_anchors(tmp_path / "anchors.json", RECORD)
    assert (tmp_path / "anchors.json").read_text() == "mine"


def test_a_link_that_leads_nowhere_is_kept(tmp_path):
    (tmp_path / "anchors.json").symlink_to("nowhere")
    with pytest.raises(OutputError, match="it exists already"):
        write_anchors(tmp_path / "anchors.json", RECORD)
    assert (tmp_path / "anchors.json").readlink().name == "nowhere"


def test_a_place_is_looked_at_and_left_as_it_was(tmp_path):
    check_new_file(tmp_path / "new" / "newer" / "anchors.json")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"schema_version": 2}, "field schema_version: .*; got 2"),
        ({"centres_m": []}, "field centres_m: "),
        ({"centres_m": [[1.0, 2.0]]}, r"field centres_m\.0\.2: Field required"),
        ({"centres_m": [[1.0, 2.0, "3"]]}, r"field centres_m\.0\.2: .*; got '3'"),
        ({"num_boxes": 0}, "field num_boxes"),
        ({"centres_m": [[0, 0, 0], [33.0, -44.1, 0]]}, r"field centres_m: .*range_m, 55 m, .*index 1 is 55\.08 m away"),
        ({"centres_m": [[0, 0, 1e300]]}, r"field centres_m: .*index 0 is 1e\+300 m away"),
        ({"range_m": 1e300, "centres_m": [[0, 0, 1e300]]}, r"field range_m: .*less than or equal to 1000; got 1e\+300"),
        ({"boxes": 9}, "field boxes: .*not permitted"),
    ],
)
def test_a_field_that_is_wrong_is_named(tmp_path, change, words):
    path = tmp_path / "anchors.json"
    path.write_text(json.dumps(RECORD.model_dump(mode="json") | change))
    with pytest.raises(ArtifactError, match=rf"anchors\.json: {words}"):
        read_anchors(path)


def test_a_centre_may_lie_at_the_range_itself(tmp_path):
    path = tmp_path / "anchors.json"
    path.write_text(json.dumps(RECORD.model_dump(mode="json") | {"centres_m": [[33.0, -44.0, 0.0]]}))
    assert read_anchors(path).centres.tolist() == [[33.0, -44.0, 0.0]]


@pytest.mark.parametrize("value", ["NaN", "Infinity", "1e999"])
def test_numbers_that_are_not_finite_are_refused(tmp_path, value):
    path = tmp_path / "anchors.json"
    path.write_text(RECORD.model_dump_json().replace("4.5", value))
    with pytest.raises(ArtifactError, match=r"field centres_m\.1\.0: "):
        read_anchors(path)


def test_a_file_that_is_missing_or_no_json_is_refused_by_name(tmp_path):
    with pytest.raises(ArtifactError, match=r"none\.json: expected a JSON file"):
        read_anchors(tmp_path / "none.json")
    (tmp_path / "binary.json").write_bytes(b"\x93NUMPY")
    with pytest.raises(ArtifactError, match=r"binary\.json: cannot be read as UTF-8"):
        read_anchors(tmp_path / "binary.json")


def test_boxes_that_stand_still_count_once():
    """A parked ego with parked cars: four places, in ten frames."""
    places = np.array([[10.0, 0, 0], [20, 0, 0], [0, 5, 0], [0, -5, 0]])
    with pytest.raises(InputError, match=r"at least 5 true boxes.*got 4 of 40 in 10 frames, each place counted once"):
        centres_within_range([places] * 10, num_queries=5)
    assert len(centres_within_range([places] * 10, num_queries=4)) == 40
