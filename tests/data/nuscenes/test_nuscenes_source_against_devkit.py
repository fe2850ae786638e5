"""The same root, read by this toolkit and by nuscenes-devkit 1.2.0."""

import json

import numpy as np
import pytest

from duospacenet.data.nuscenes.nuscenes_source import NuscenesSource
from duospacenet.runtime.geometry import rotation_z, transform
from duospacenet.synthetic.nuscenes_root.root_writer import write_nuscenes_root
from tests.helpers.devkit import run_devkit

TILT = np.array([0.9998, 0.008, -0.015, 0.0])  # a rotation by 2 degrees about an axis in the ground plane


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    """A synthetic root with gaps in time, and with ego poses that pitch, roll and climb."""
    root = tmp_path_factory.mktemp("nuscenes") / "root"
    write_nuscenes_root(root, 2, 6, seed=7, image_size=(160, 90))
    edit(root, "ego_pose", lambda rows: [tilt(number, pose) for number, pose in enumerate(rows)])
    edit(root, "sample", lambda rows: [delay(number, sample) for number, sample in enumerate(rows)])
    return root


def edit(root, table, change):
    path = root / "v1.0-mini" / f"{table}.json"
    path.write_text(json.dumps(change(json.loads(path.read_text()))))


def tilt(number, pose):
    """Tilt a pose, in another direction each time. pyquaternion's order of multiplication: global_R_ego @ tilt."""
    w, x, y, z = pose["rotation"]
    a, b, c, d = TILT * [1, (-1) ** number, 1 + number % 3, 1]
    product = [
        w * a - x * b - y * c - z * d,
        w * b + x * a + y * d - z * c,
        w * c - x * d + y * a + z * b,
        w * d + x * c - y * b + z * a,
    ]
    rotation = (np.array(product) / np.linalg.norm(product)).tolist()
    return {**pose, "rotation": rotation, "translation": [*pose["translation"][:2], 0.1 * number]}


def delay(number, sample):
    """Move the last samples of each scene two seconds later, and the one before them by 0.7 s."""
    delays = {3: 700_000, 4: 2_000_000, 5: 2_700_000}
    return {**sample, "timestamp": sample["timestamp"] + delays.get(number % 6, 0)}


@pytest.mark.slow
def test_frames_cameras_boxes_and_velocities_are_those_of_the_devkit(root):
    expected = run_devkit("frames.py", root, "v1.0-mini")
    source = NuscenesSource(str(root))
    assert set(source.tokens) == set(expected)
    num_boxes, num_unknown, num_visible = 0, 0, 0
    for index in range(len(source)):
        frame, truth = source.frame_without_images(index), source.ground_truth_without_maps(index)
        sample = expected[frame.token]
        assert frame.scene == sample["scene"]
        assert frame.timestamp_s == pytest.approx(sample["timestamp_us"] * 1e-6, abs=1e-7)
        np.testing.assert_allclose(frame.global_T_ego, sample["global_T_ego"], atol=1e-9)
        assert set(frame.cameras) == set(sample["cameras"])
        centres = {box["token"]: np.array(box["centre"]) for box in sample["boxes"]}
        for name, camera in frame.cameras.items():
            reference = sample["cameras"][name]
            np.testing.assert_allclose(camera.camera_T_ego, reference["camera_T_ego"], atol=1e-9)
            np.testing.assert_array_equal(camera.intrinsics_px, reference["intrinsics"])
            for token, centre in reference["visible_centres"].items():  # boxes of get_sample_data, in the camera frame
                np.testing.assert_allclose(transform(camera.camera_T_ego, centres[token]), centre, atol=1e-9)
                num_visible += 1
        boxes = sample["boxes"]
        assert truth.classes == tuple(box["category"] for box in boxes)
        assert truth.attributes == tuple("".join(box["attributes"]) for box in boxes)
        assert truth.num_points.tolist() == [box["num_points"] for box in boxes]
        global_R_ego = frame.global_T_ego[:3, :3]
        for box, reference in zip(truth.boxes, boxes, strict=True):
            np.testing.assert_allclose(box[:6], [*reference["centre"], *reference["size"]], atol=1e-9)
            heading = global_R_ego @ rotation_z(box[6])[:, 0]
            turn = np.arctan2(heading[1], heading[0]) - reference["yaw_global"]
            assert abs(np.arctan2(np.sin(turn), np.cos(turn))) < 1e-9
            velocity = (global_R_ego @ [*box[7:], 0])[:2]
            np.testing.assert_allclose(velocity, reference["velocity_global"], atol=1e-6)
            num_unknown += int(np.isnan(box[7]))
        num_boxes += len(boxes)
    assert num_boxes > 200
    assert 5 < num_unknown < num_boxes / 2
    assert num_visible > 100
