"""The frames of the tiny root of tests/helpers/nuscenes_tables.py, whose numbers are worked out by hand."""

import pickle

import cv2
import numpy as np
import pytest

from duospacenet.data.nuscenes.nuscenes_source import NuscenesSource
from duospacenet.jobs.sources import open_recording, open_source, with_fast_decoding
from duospacenet.runtime.bundle.preprocessing_record import Preprocessing
from duospacenet.runtime.errors import InputError
from duospacenet.runtime.geometry import transform
from tests.helpers.nuscenes_tables import image_name, row, tiny_tables, write_tables, write_tiny_root
from tests.helpers.scene_folders import assert_frames_equal


@pytest.fixture
def source(tmp_path):
    return NuscenesSource(str(write_tiny_root(tmp_path / "root")))


def test_frames_are_sorted_by_scene_and_time(source):
    assert len(source) == 4
    frames = list(source)
    assert [frame.token for frame in frames] == list(source.tokens) == ["a0", "b0", "b1", "b2"]
    assert [frame.scene for frame in frames] == ["scene-0061", *["scene-0103"] * 3]
    assert [source.scene_name(index) for index in range(4)] == [frame.scene for frame in frames]
    assert [frame.timestamp_s for frame in frames] == [1500000009.0, 1500000000.0, 1500000000.5, 1500000001.0]


def test_the_ego_pose_is_that_of_the_lidar(source):
    # Forward (x) is global y, and left (y) is global -x.
    expected = [[0, -1, 0, 100], [1, 0, 0, 54], [0, 0, 1, 0], [0, 0, 0, 1]]
    np.testing.assert_allclose(source.frame_without_images(2).global_T_ego, expected, atol=1e-12)


def test_a_camera_has_its_own_ego_pose(source):
    cameras = source.frame_without_images(1).cameras
    assert list(cameras) == ["CAM_FRONT", "CAM_BACK"]
    # At the time of the image, the ego is 0.4 m farther back. The front camera is 1.5 m before it, 1.6 m high.
    front = transform(cameras["CAM_FRONT"].camera_T_ego, np.array([[10.0, 0, 1.6], [10, 2, 0.6]]))
    np.testing.assert_allclose(front, [[0, 0, 8.9], [-2, 1, 8.9]], atol=1e-12)
    back = transform(cameras["CAM_BACK"].camera_T_ego, np.array([[-10.0, 2, 1.6]]))
    np.testing.assert_allclose(back, [[2, 0, 9.1]], atol=1e-12)
    assert cameras["CAM_BACK"].intrinsics_px.tolist() == [[20, 0, 16], [0, 20, 8], [0, 0, 1]]
    assert (cameras["CAM_BACK"].width_px, cameras["CAM_BACK"].height_px) == (32, 16)


def test_a_calibration_may_change_from_frame_to_frame(tmp_path):
    tables = tiny_tables()
    tables["calibrated_sensor"].append({**row(tables, "calibrated_sensor", "ccf"), "token": "new"})
    row(tables, "calibrated_sensor", "new")["translation"] = [2.5, 0, 1.6]
    row(tables, "sample_data", "b1-CAM_FRONT")["calibrated_sensor_token"] = "new"
    source = NuscenesSource(str(write_tiny_root(tmp_path, tables)))
    points = [source.frame_without_images(index).cameras["CAM_FRONT"].camera_T_ego[2, 3] for index in (1, 2, 3)]
    np.testing.assert_allclose(points, [-1.1, -2.1, -1.1])


def test_boxes_are_in_the_ego_frame(source):
    truth = source.ground_truth_without_maps(1)
    assert truth.classes == ("vehicle.bus.rigid", "static_object.bicycle_rack")
    assert truth.attributes == ("vehicle.moving", "")
    assert truth.num_points.tolist() == [9, 0]
    # 10 m ahead and driving ahead at 8 m/s, which is 4 m to the next annotation; 2 m to the left, alone.
    expected = [[10, 0, 1.5, 2.5, 10, 3, 0, 8, 0], [0, 2, 0.5, 2.5, 10, 3, 0, np.nan, np.nan]]
    np.testing.assert_allclose(truth.boxes, expected, atol=1e-12)
    # From the annotation before to the one after it: 6 m in 1 s. At the end: 2 m in half a second.
    np.testing.assert_allclose(source.ground_truth_without_maps(2).boxes[:, 7:], [[6, 0]], atol=1e-12)
    np.testing.assert_allclose(source.ground_truth_without_maps(3).boxes[:, 7:], [[4, 0]], atol=1e-12)
    assert source.ground_truth_without_maps(3).attributes == ("vehicle.stopped",)


def test_a_frame_without_annotations_has_no_boxes_and_they_are_known(source):
    assert source.has_boxes(0)
    truth = source.frame(0).ground_truth
    assert truth.has_boxes
    assert truth.boxes.shape == (0, 9)
    assert truth.attributes == ()


def test_boxes_of_a_version_without_annotations_are_unknown(tmp_path):
    tables = tiny_tables() | {"sample_annotation": [], "instance": []}
    source = NuscenesSource(str(write_tiny_root(tmp_path, tables, "v1.0-test")))
    assert not source.has_boxes(0)
    assert source.frame(0).ground_truth is None
    source.check_class_names(("car",))


def test_images_are_read_and_a_missing_file_is_a_lost_camera(source):
    (source.root / image_name("b1", "CAM_BACK")).unlink()
    frame = source.frame(2)
    assert frame.images["CAM_BACK"] is None
    assert frame.images["CAM_FRONT"].shape == (16, 32, 3)
    assert frame.images["CAM_FRONT"].mean() == 200
    assert list(frame.cameras) == ["CAM_FRONT", "CAM_BACK"]
    assert source.check_image_files(2) == ("CAM_BACK",)
    assert source.check_image_files(1) == ()


def test_a_camera_without_a_row_in_a_sample_is_lost_in_that_frame(tmp_path):
    tables = tiny_tables()
    tables["sample_data"].remove(row(tables, "sample_data", "b1-CAM_FRONT"))
    source = NuscenesSource(str(write_tiny_root(tmp_path, tables)))
    frame = source.frame(2)
    assert frame.images["CAM_FRONT"] is None
    assert frame.images["CAM_BACK"] is not None
    assert source.check_image_files(2) == ("CAM_FRONT",)
    # The calibration is the mounting of the camera, 1.5 m before the ego.
    np.testing.assert_allclose(frame.cameras["CAM_FRONT"].camera_T_ego[:3, 3], [0, 1.6, -1.5], atol=1e-12)


def test_an_image_of_another_size_is_refused_with_its_path(source):
    path = source.root / image_name("a0", "CAM_FRONT")
    cv2.imwrite(str(path), np.zeros((8, 8, 3), np.uint8))
    for read in (source.frame, source.check_image_files):
        with pytest.raises(InputError, match=r"CAM_FRONT/a0\.jpg: expected 32x16 px.* got 8x8 px"):
            read(0)


@pytest.mark.parametrize(
    ("split", "tokens"),
    [
        ("", ["a0", "b0", "b1", "b2"]),
        ("/mini_train", ["a0"]),
        ("/mini_val", ["b0", "b1", "b2"]),
        ("/val", ["b0", "b1", "b2"]),
        ("/scene-0103,scene-0061", ["b0", "b1", "b2", "a0"]),
        ("/scene-0061", ["a0"]),
    ],
)
def test_a_split_or_a_list_of_scenes_chooses_the_frames(tmp_path, split, tokens):
    source = open_source(f"nuscenes:{write_tiny_root(tmp_path)}@v1.0-mini{split}")
    assert list(source.tokens) == tokens
    assert [frame.token for frame in source] == tokens


def test_the_identity_is_that_of_the_tables_and_the_scenes(tmp_path):
    one = write_tiny_root(tmp_path / "one")
    names = [f"{one}{split}" for split in ("", "/mini_val", "/scene-0103", "/scene-0103,scene-0061")]
    identities = {name: NuscenesSource(name).identity for name in names}
    assert len(set(identities.values())) == len(names)
    assert NuscenesSource(str(write_tiny_root(tmp_path / "two"))).identity == identities[str(one)]
    tables = tiny_tables()
    row(tables, "sample_annotation", "bus0")["num_radar_pts"] = 3
    assert NuscenesSource(str(write_tiny_root(tmp_path / "three", tables))).identity != identities[str(one)]


def test_a_pickled_source_is_small_and_gives_the_same_frames(source):
    pickled = pickle.dumps(source)
    assert len(pickled) < 2000
    again = pickle.loads(pickled)
    for one, other in zip(source, again, strict=True):
        assert_frames_equal(one, other)


def test_a_pickled_source_is_refused_if_the_root_has_changed(source):
    pickled = pickle.dumps(source)
    tables = tiny_tables()
    row(tables, "ego_pose", "b0-LIDAR_TOP")["translation"] = [0, 0, 0]
    write_tables(source.root, tables)
    NuscenesSource(str(source.root))
    with pytest.raises(InputError, match="expected the index that this command has opened"):
        pickle.loads(pickled).frame(0)


def test_categories_that_stand_for_no_class_are_refused_with_their_rows(tmp_path):
    tables = tiny_tables()
    row(tables, "category", "c-bus")["name"] = "vehicle.hovercraft"
    row(tables, "category", "c-walker")["name"] = "unused and unknown"
    source = NuscenesSource(str(write_tiny_root(tmp_path, tables)))
    with pytest.raises(
        InputError,
        match=r"category\.json: expected .*; got 'vehicle\.hovercraft' \(row 1, token 'c-bus', 3 boxes\)\. Rename",
    ):
        source.check_class_names(("car", "bus"))
    NuscenesSource(f"{tmp_path}/scene-0061").check_class_names(("car", "bus"))  # has no boxes


def test_categories_of_the_same_name_are_counted_each(tmp_path):
    tables = tiny_tables()
    for token in ("c-rack", "c-bus", "c-walker"):
        row(tables, "category", token)["name"] = "hovercraft"
    source = NuscenesSource(str(write_tiny_root(tmp_path, tables)))
    expected = r"got 'hovercraft' \(row 0, token 'c-rack', 1 box\), 'hovercraft' \(row 1, token 'c-bus', 3 boxes\)\."
    with pytest.raises(InputError, match=expected):
        source.check_class_names(("car",))


def test_known_categories_are_accepted(source):
    source.check_class_names(("car", "bus"))
    source.check_class_names(("pedestrian",))


def test_jpeg_files_are_decoded_at_a_reduced_size_where_that_is_enough(source):
    preprocessing = Preprocessing.model_construct(width_px=8, height_px=4)
    frame = with_fast_decoding(source, preprocessing).frame(1)
    camera = frame.cameras["CAM_FRONT"]
    assert frame.images["CAM_FRONT"].shape == (camera.height_px, camera.width_px, 3) != (16, 32, 3)
    np.testing.assert_allclose(camera.intrinsics_px[0, 0] / 20, camera.width_px / 32)


def test_impossible_calibrations_are_refused_unless_the_rig_is_checked(tmp_path):
    tables = tiny_tables()
    tables["calibrated_sensor"].append({**row(tables, "calibrated_sensor", "ccb"), "token": "new"})
    row(tables, "calibrated_sensor", "new")["camera_intrinsic"] = [[0.01, 0, 0.5], [0, 0.01, 0.5], [0, 0, 1]]
    for sample in ("b1", "b2"):
        row(tables, "sample_data", f"{sample}-CAM_BACK")["calibrated_sensor_token"] = "new"
    name = f"nuscenes:{write_tiny_root(tmp_path, tables)}"
    with pytest.raises(InputError, match=r"v1\.0-mini: frame 2: camera CAM_BACK: intrinsics_px: expected a focal"):
        open_source(name)
    assert len(open_source(f"{name}/scene-0061")) == 1
    recording = open_recording(name)
    assert recording.frame_without_images(2).cameras["CAM_BACK"].intrinsics_px[0, 0] == 0.01
    assert recording.ground_truth(1).boxes.shape == (2, 9)


def test_a_recording_has_the_images_of_a_root(source):
    (source.root / image_name("b0", "CAM_BACK")).unlink()
    (source.root / image_name("b0", "CAM_FRONT")).write_bytes(b"damaged")
    images = open_recording(f"nuscenes:{source.root}").camera_images(1)
    assert images["CAM_BACK"].path is None
    assert "b0.jpg" in str(images["CAM_FRONT"].error)


def test_a_file_name_that_no_file_can_have_is_an_error_with_its_path(tmp_path):
    tables = tiny_tables()
    row(tables, "sample_data", "b0-CAM_BACK")["filename"] = "x" * 300
    source = NuscenesSource(str(write_tiny_root(tmp_path, tables)))
    for read in (source.frame, source.check_image_files):
        with pytest.raises(InputError, match="xxx: cannot be read"):
            read(1)


def test_a_frame_number_that_does_not_exist_is_an_index_error(source):
    for index in (-1, 4):
        with pytest.raises(IndexError):
            source.frame_without_images(index)
