"""The geometry of the example converter on real frames. Expected values come from the data set itself."""

import json
from itertools import pairwise

import numpy as np
import pytest

from duospacenet.data.scene_folder import SceneFolder
from duospacenet.drawing.box_style import CLASS_COLOURS
from duospacenet.runtime.geometry import image_T_ego, project, transform
from examples.nuscenes_scene import DATA, has_data, load_frames, load_records, main, write_scene_folder

pytestmark = pytest.mark.skipif(not has_data(), reason="the nuScenes frames are not beside this checkout")


@pytest.fixture(scope="module")
def records():
    return load_records()


@pytest.fixture(scope="module")
def frames():
    return load_frames()


def project_into(frame, name, points):
    camera = frame.cameras[name]
    return project(points, image_T_ego(camera.intrinsics_px, camera.camera_T_ego))


def test_every_annotated_centre_is_inside_some_image(frames):
    num_visible, num_boxes = 0, 0
    for frame in frames:
        is_visible = np.zeros(len(frame.ground_truth.boxes), bool)
        for name, camera in frame.cameras.items():
            pixels, depth_m = project_into(frame, name, frame.ground_truth.boxes[:, :3])
            inside = ((pixels >= 0) & (pixels <= (camera.width_px, camera.height_px))).all(axis=1)
            is_visible |= inside & (depth_m > 0.1)
        num_visible += is_visible.sum()
        num_boxes += len(is_visible)
    assert num_visible == num_boxes == 124


def test_projection_from_the_ego_frame_equals_the_data_sets_projection_from_the_lidar_frame(records, frames):
    worst_px, num_points = 0.0, 0
    for record, frame in zip(records, frames, strict=True):
        centers_lidar = np.array(record["gt"]["center"])
        for name, camera in record["cams"].items():
            expected_px, expected_depth_m = project(centers_lidar, np.array(camera["lidar2img"])[:3])
            pixels, depth_m = project_into(frame, name, frame.ground_truth.boxes[:, :3])
            near = (expected_depth_m > 1.0) & (np.abs(expected_px - 800) < 1600).all(axis=1)
            np.testing.assert_allclose(depth_m[near], expected_depth_m[near], atol=2e-3)
            worst_px = max(worst_px, np.abs(pixels - expected_px)[near].max(initial=0.0))
            num_points += near.sum()
    assert num_points > 124
    assert worst_px < 0.5


def test_fast_vehicles_move_along_their_heading(frames):
    boxes = np.concatenate([frame.ground_truth.boxes for frame in frames])
    fast = boxes[np.hypot(boxes[:, 7], boxes[:, 8]) > 4.0]
    direction = np.arctan2(fast[:, 8], fast[:, 7])
    offset = np.angle(np.exp(1j * (direction - fast[:, 6])))
    assert len(fast) >= 8
    assert np.abs(offset).max() < np.deg2rad(12)


def test_tracked_boxes_move_with_their_annotated_velocities(records, frames):
    errors_m_s, speeds_m_s = [], []
    for i in range(len(frames) - 1):
        now, later = frames[i], frames[i + 1]
        tracks = {track: row for row, track in enumerate(records[i + 1]["gt"]["track_id"])}
        for row, track in enumerate(records[i]["gt"]["track_id"]):
            if track not in tracks:
                continue
            box, later_box = now.ground_truth.boxes[row], later.ground_truth.boxes[tracks[track]]
            moved = transform(later.global_T_ego, later_box[:3]) - transform(now.global_T_ego, box[:3])
            velocity = now.global_T_ego[:3, :3] @ np.array([*box[7:], 0.0])
            measured = moved / (later.timestamp_s - now.timestamp_s)
            errors_m_s.append(np.hypot(*(measured - velocity)[:2]))
            speeds_m_s.append(np.hypot(*box[7:]))
    assert len(errors_m_s) > 50
    assert np.median(speeds_m_s) > 1.0
    assert np.median(errors_m_s) < 0.1
    assert max(errors_m_s) < 2.0


def test_the_ego_vehicle_drives_forward_at_8_m_s(frames):
    for now, later in pairwise(frames):
        step_m = np.linalg.solve(now.global_T_ego, later.global_T_ego)[:3, 3]
        speed_m_s = step_m / (later.timestamp_s - now.timestamp_s)
        np.testing.assert_allclose(speed_m_s[0], 8.4, atol=0.4)
        assert abs(speed_m_s[1]) < 0.5


def test_boxes_are_on_the_ground_and_have_known_classes(frames):
    for frame in frames:
        x, y, z, _, _, height = frame.ground_truth.boxes[:, :6].T
        near = np.hypot(x, y) < 20
        assert np.abs(z - height / 2)[near].max() < 1.0
        assert set(frame.ground_truth.classes) <= set(CLASS_COLOURS)


def test_a_scene_folder_has_the_values_of_the_frames(tmp_path, frames):
    folder = write_scene_folder(tmp_path / "scene", frames=[1, 3])
    scene = json.loads((folder / "scene.json").read_text())
    assert sorted(path.name for path in folder.iterdir()) == ["nuscenes", "scene.json"]
    assert (scene["schema_version"], scene["scene"]) == (1, "scene-0103")
    for written, frame in zip(scene["frames"], [frames[1], frames[3]], strict=True):
        assert written["timestamp_s"] == frame.timestamp_s
        assert written["token"] == frame.token
        assert np.array_equal(written["global_T_ego"], frame.global_T_ego)
        for name, camera in frame.cameras.items():
            assert np.array_equal(written["cameras"][name]["camera_T_ego"], camera.camera_T_ego)
        assert np.array_equal([box_row(box) for box in written["boxes"]], frame.ground_truth.boxes, equal_nan=True)
        assert tuple(box["class"] for box in written["boxes"]) == frame.ground_truth.classes


def box_row(box):
    velocity = (np.nan, np.nan) if box["velocity_m_s"] is None else box["velocity_m_s"]
    return [*box["center_m"], *box["size_wlh_m"], box["yaw_rad"], *velocity]


def test_an_unknown_velocity_is_null_in_a_scene_folder(tmp_path, monkeypatch):
    """nuScenes has NaN as the velocity of an object that was annotated only once."""
    records = load_records()
    records[0]["gt"]["velocity"][0] = [float("nan")] * 3
    monkeypatch.setattr("examples.nuscenes_scene.load_records", lambda data: records)
    folder = write_scene_folder(tmp_path / "scene", frames=[0])
    (frame,) = json.loads((folder / "scene.json").read_text())["frames"]
    assert [box["velocity_m_s"] is None for box in frame["boxes"]] == [True] + [False] * (len(frame["boxes"]) - 1)
    assert np.isnan(SceneFolder(folder).ground_truth_without_maps(0).boxes).sum() == 2


def test_a_scene_folder_has_paths_to_the_original_images_through_a_link(tmp_path):
    write_scene_folder(tmp_path)  # a second time: the link is replaced
    scene = json.loads((write_scene_folder(tmp_path) / "scene.json").read_text())
    images = [camera["image"] for frame in scene["frames"] for camera in frame["cameras"].values()]
    assert len(set(images)) == 24
    assert all((tmp_path / image).resolve().is_relative_to(DATA.resolve()) for image in images)


def test_repeated_frames_are_scenes_of_their_own_with_unique_tokens(tmp_path):
    scene = json.loads((write_scene_folder(tmp_path, repeats=2) / "scene.json").read_text())
    assert len({frame["token"] for frame in scene["frames"]}) == len(scene["frames"]) == 8
    assert [frame["scene"] for frame in scene["frames"]] == ["scene-0103"] * 4 + ["scene-0103, repeat 1"] * 4


def test_the_command_reads_the_data_folder_that_it_is_given(tmp_path, monkeypatch):
    data = tmp_path / "data"
    data.mkdir()
    (data / "frames.json").write_text(json.dumps(load_records()[:1]))
    monkeypatch.setattr("sys.argv", ["nuscenes_scene", str(tmp_path / "out"), "3", "--data", str(data)])
    main()
    scene = json.loads((tmp_path / "out" / "scene.json").read_text())
    assert len(scene["frames"]) == 3
    assert (tmp_path / "out" / "nuscenes").resolve() == data
