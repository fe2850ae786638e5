import signal

import cv2
import numpy as np
import pytest

from duospacenet.data.anchor_clustering import centres_within_range, cluster_centres
from duospacenet.data.box_selection import known_ground_truth
from duospacenet.data.scene_folder import SceneFolder
from duospacenet.runtime.errors import InputError
from duospacenet.synthetic.drive import SyntheticDrive
from tests.helpers.json_edits import deep_copy
from tests.helpers.scene_folders import EXAMPLE_SCENE, POSE_AT_ORIGIN, write_example_scene

# Three groups, tens of metres apart, keyed by their means, which were computed by hand.
GROUPS = {
    (20.0, 0.0, 1.0): [(19.0, -1.0, 0.5), (21.0, 1.0, 1.5)],
    (-10.0, 30.0, 0.5): [(-10.0, 30.0, 0.5)],
    (-30.0, -20.0, 2.0): [(-31.0, -20.0, 1.0), (-29.0, -21.0, 2.0), (-30.0, -19.0, 3.0)],
}
POINTS = np.array([point for group in GROUPS.values() for point in group])


def sorted_rows(points) -> np.ndarray:
    points = np.asarray(points, dtype=np.float64)
    return points[np.lexsort(points.T)]


def box_record(*centre_m):
    return {"class": "car", "center_m": centre_m, "size_wlh_m": [2, 4, 2], "yaw_rad": 0.3, "velocity_m_s": [1, 0]}


def scene_with_boxes(folder, centres_by_frame, poses=(POSE_AT_ORIGIN, POSE_AT_ORIGIN)):
    """The example scene, whose two frames have boxes at these centres and these ego poses."""
    frames = deep_copy(EXAMPLE_SCENE["frames"])
    for frame, centres, pose in zip(frames, centres_by_frame, poses, strict=True):
        frame.pop("boxes", None)
        frame["global_T_ego"] = pose
        if centres is not None:
            frame["boxes"] = [box_record(*centre) for centre in centres]
    return SceneFolder(write_example_scene(folder, frames=frames))


# --- Clusters -----------------------------------------------------------------------------------------------------


def test_centroids_of_well_separated_groups_are_the_groups_means():
    clusters = cluster_centres(POINTS, 3)
    np.testing.assert_allclose(sorted_rows(clusters.centroids), sorted_rows(list(GROUPS)), atol=1e-12)


def test_the_distance_is_the_root_mean_square_to_the_nearest_centroid():
    squares = [(1 + 1 + 0.25), (1 + 1 + 0.25), 0, (1 + 0 + 1), (1 + 1 + 0), (0 + 1 + 1)]
    assert cluster_centres(POINTS, 3).rms_distance_m == pytest.approx(np.sqrt(sum(squares) / 6))


def test_axes_are_compared_in_metres_and_not_standardised():
    """The points span 20 m in x and 2 m in z. Two clusters split x; after standardisation they would split z."""
    points = np.array([[x, 0.0, z] for x in (0.0, 7.0, 13.0, 20.0) for z in (0.0, 2.0)])
    np.testing.assert_allclose(sorted_rows(cluster_centres(points, 2).centroids), [[3.5, 0, 1], [16.5, 0, 1]])


def test_as_many_clusters_as_points_gives_the_points():
    np.testing.assert_allclose(sorted_rows(cluster_centres(POINTS, len(POINTS)).centroids), sorted_rows(POINTS))


def test_centroids_depend_on_the_seed_only():
    points = np.random.default_rng(0).normal(0, 20, (500, 3))
    first, other, again = (cluster_centres(points, 40, seed).centroids for seed in (5, 6, 5))
    assert np.array_equal(first, again)
    assert not np.array_equal(sorted_rows(first), sorted_rows(other))


def test_identical_points_give_finite_centroids():
    centroids = cluster_centres(np.ones((8, 3)), 3).centroids
    np.testing.assert_array_equal(np.nan_to_num(centroids, nan=-1), np.ones((3, 3)))


def test_a_single_point_is_its_own_centroid():
    """OpenCV would take the row of three numbers for three points."""
    clusters = cluster_centres(np.array([[4.0, -5.0, 0.75]]), 1)
    assert clusters.centroids.tolist() == [[4.0, -5.0, 0.75]]
    assert clusters.rms_distance_m == 0


def test_the_best_of_several_starts_is_kept(monkeypatch):
    """The last result of OpenCV for each start is the sum of squares of that start. They differ; the least is kept."""
    points = np.random.default_rng(0).normal(0, 20, (300, 3))
    sums_of_squares, kmeans = [], cv2.kmeans

    def recording_kmeans(*arguments):
        result = kmeans(*arguments)
        if arguments[-1] == cv2.KMEANS_PP_CENTERS:
            sums_of_squares.append(result[0])
        sums_of_squares[-1] = result[0]
        return result

    monkeypatch.setattr(cv2, "kmeans", recording_kmeans)
    rms_distance_m = cluster_centres(points, 30).rms_distance_m
    assert len(set(sums_of_squares)) == 3
    assert rms_distance_m == pytest.approx(np.sqrt(min(sums_of_squares) / 300), rel=1e-5)


def test_every_centroid_is_the_mean_of_the_points_nearest_to_it():
    points = np.random.default_rng(1).normal(0, 20, (400, 3))
    centroids = cluster_centres(points, 12).centroids
    nearest = ((points[:, None] - centroids) ** 2).sum(axis=-1).argmin(axis=1)
    means = [points[nearest == index].mean(axis=0) for index in range(12)]
    np.testing.assert_allclose(centroids, means, atol=0.01)


@pytest.fixture
def default_sigint():
    """Ctrl-C raises KeyboardInterrupt, even if the process that runs the tests ignores it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_an_interruption_is_handled_between_two_iterations(monkeypatch, default_sigint):
    calls, kmeans = [], cv2.kmeans

    def interrupted_kmeans(points, num_clusters, labels, criteria, attempts, flags):
        calls.append((criteria[1], attempts))
        if len(calls) == 3:
            signal.raise_signal(signal.SIGINT)
        return kmeans(points, num_clusters, labels, criteria, attempts, flags)

    monkeypatch.setattr(cv2, "kmeans", interrupted_kmeans)
    with pytest.raises(KeyboardInterrupt):
        cluster_centres(np.random.default_rng(0).normal(0, 20, (500, 3)), 40)
    assert calls == [(2, 1)] * 3  # a limit of 2 is the smallest that OpenCV accepts


# --- The ground truth of a source ---------------------------------------------------------------------------------


def test_centres_are_in_the_ego_frame_of_their_own_frame(tmp_path):
    moved = np.eye(4)
    moved[:2, :2] = [[0, -1], [1, 0]]
    moved[:3, 3] = (100.0, -40.0, 1.0)
    source = scene_with_boxes(tmp_path, [[(10, 0, 1)], [(12, 0, 1)]], (POSE_AT_ORIGIN, moved.tolist()))
    centres = [ground_truth.boxes[:, :3] for ground_truth in known_ground_truth(source, range(2))]
    assert [rows.tolist() for rows in centres] == [[[10, 0, 1]], [[12, 0, 1]]]
    np.testing.assert_allclose(cluster_centres(centres_within_range(centres, 1), 1).centroids, [[11, 0, 1]])


def test_centres_of_a_synthetic_drive_are_those_of_its_frames():
    drive = SyntheticDrive(7, frames=3, image_size=(160, 64))
    for frame, ground_truth in zip(drive, known_ground_truth(drive, range(3)), strict=True):
        np.testing.assert_array_equal(ground_truth.boxes, frame.ground_truth.boxes)


def test_the_images_of_a_scene_folder_are_not_read(tmp_path):
    source = scene_with_boxes(tmp_path, [[(10, 0, 1)], None])
    for path in tmp_path.glob("*.png"):
        path.unlink()
    assert [known.boxes[:, :3].tolist() for known in known_ground_truth(source, range(2))] == [[[10, 0, 1]]]


def test_a_frame_with_unknown_boxes_is_left_out_and_one_with_no_boxes_is_not(tmp_path):
    for centres, number in (([None, [(1, 1, 1)]], 1), ([[], [(1, 1, 1)]], 2), ([None, None], 0)):
        assert len(list(known_ground_truth(scene_with_boxes(tmp_path, centres), range(2)))) == number


def test_centres_beyond_the_range_are_left_out_by_their_distance_in_three_dimensions():
    centres = [np.array([[30.0, 40.0, 0.0], [30.0, 40.0, 1.0]]), np.array([[-60.0, 0, 0]])]
    assert centres_within_range(centres, 1, 50.0).tolist() == [[30.0, 40.0, 0.0]]
    assert len(centres_within_range(centres, 1)) == 2


def test_fewer_boxes_than_queries_are_refused_with_both_numbers():
    centres = [np.arange(9.0).reshape(3, 3), np.full((2, 3), 99.0)]
    with pytest.raises(
        InputError, match=r"at least 4 different box centres within 55 m.*got 3 among 5 boxes in 2 frames.*fewer quer"
    ):
        centres_within_range(centres, 4)


def test_the_message_says_one_frame_without_a_plural_s():
    with pytest.raises(InputError, match=r"got 3 among 3 boxes in 1 frame\."):
        centres_within_range([np.eye(3)], 4)


def test_a_source_without_known_boxes_is_refused():
    with pytest.raises(InputError, match=r"expected boxes in the source; got no frame with known boxes"):
        centres_within_range([], 4)


def test_boxes_at_the_same_place_count_once():
    """A parked ego that detects parked cars: four places in ten frames."""
    places = np.array([[10.0, 0, 0], [20, 0, 0], [0, 5, 0], [0, -5, 0]])
    with pytest.raises(InputError, match=r"at least 5 different box centres.*got 4 among 40 boxes in 10 frames"):
        centres_within_range([places] * 10, num_queries=5)
    assert len(centres_within_range([places] * 10, num_queries=4)) == 40
