"""The four real nuScenes frames, read through a root that holds them. They are not part of this repository."""

import numpy as np
import pytest

from duospacenet.data.class_names import find_class
from duospacenet.data.nuscenes.nuscenes_source import NuscenesSource
from examples.nuscenes_scene import has_data, load_frames, load_records
from tests.helpers.real_root import write_real_root

pytestmark = pytest.mark.skipif(not has_data(), reason="needs the four nuScenes frames beside the repository")


@pytest.fixture(scope="module")
def expected():
    """The frames as the example converter reads them, without a root."""
    return load_frames()


@pytest.fixture
def source(tmp_path):
    return NuscenesSource(str(write_real_root(tmp_path / "root")))


def test_poses_times_and_calibrations_are_those_of_the_frames(source, expected):
    assert list(source.tokens) == [frame.token for frame in expected]
    for index, frame in enumerate(expected):
        actual = source.frame_without_images(index)
        assert (actual.scene, actual.timestamp_s) == (frame.scene, pytest.approx(frame.timestamp_s, abs=1e-6))
        np.testing.assert_allclose(actual.global_T_ego, frame.global_T_ego, atol=1e-6)
        assert set(actual.cameras) == set(frame.cameras)
        for name, camera in frame.cameras.items():
            np.testing.assert_allclose(actual.cameras[name].camera_T_ego, camera.camera_T_ego, atol=1e-6)
            np.testing.assert_allclose(actual.cameras[name].intrinsics_px, camera.intrinsics_px, atol=1e-9)
            assert (actual.cameras[name].width_px, actual.cameras[name].height_px) == (1600, 900)


def test_images_are_those_of_the_frames(source, expected):
    actual = source.frame(2)
    for name, image in expected[2].images.items():
        # Two JPEG decoders round differently.
        assert np.abs(actual.images[name].astype(int) - image).mean() < 1


def test_boxes_classes_attributes_and_point_counts_are_those_of_the_frames(source, expected):
    total = 0
    for index, (frame, record) in enumerate(zip(expected, load_records(), strict=True)):
        actual, truth = source.ground_truth_without_maps(index), frame.ground_truth
        order = matching_rows(actual.boxes, truth.boxes)
        np.testing.assert_allclose(actual.boxes[order, :6], truth.boxes[:, :6], atol=1e-5)
        np.testing.assert_allclose(np.exp(1j * actual.boxes[order, 6]), np.exp(1j * truth.boxes[:, 6]), atol=1e-3)
        assert [find_class(actual.classes[row]) for row in order] == [find_class(name) for name in truth.classes]
        assert actual.num_points[order].tolist() == truth.num_points.tolist()
        assert [actual.attributes[row] for row in order] == record["gt"]["attribute"]
        total += len(order)
    assert total == 124


@pytest.mark.parametrize("index", [1, 2])
def test_velocities_between_two_frames_are_those_of_the_dataset(source, expected, index):
    """The frames before and after the four are missing, so only those in between have all neighbours."""
    actual, truth = source.ground_truth_without_maps(index), expected[index].ground_truth
    order = matching_rows(actual.boxes, truth.boxes)
    tracks = [set(record["gt"]["track_id"]) for record in load_records()]
    in_all = [track in tracks[index - 1] & tracks[index + 1] for track in load_records()[index]["gt"]["track_id"]]
    assert sum(in_all) > 15
    np.testing.assert_allclose(actual.boxes[order][in_all, 7:], truth.boxes[in_all, 7:], atol=0.02)


def matching_rows(actual, expected):
    """The row of the box nearest to each expected one."""
    distances = np.linalg.norm(actual[None, :, :3] - expected[:, None, :3], axis=-1)
    rows = distances.argmin(axis=1)
    assert len(set(rows.tolist())) == len(expected) == len(actual)
    return rows
