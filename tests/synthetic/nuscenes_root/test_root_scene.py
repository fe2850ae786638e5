"""The images show the annotated objects where the tables say they are, at each camera's own ego pose."""

import cv2
import numpy as np
import pytest

from duospacenet.runtime.geometry import box_corners, inverse, transform
from duospacenet.synthetic.nuscenes_root.map_layout import MapLayout
from duospacenet.synthetic.nuscenes_root.root_scene import RootScene
from duospacenet.synthetic.nuscenes_root.root_tables import make_token
from tests.helpers.nuscenes_roots import IMAGE_SIZE, pose
from tests.synthetic.nuscenes_root.conftest import NUM_FRAMES, SEED

FRAME = 5
NAMED = "scene-0061"


@pytest.fixture(scope="module")
def rendered():
    """The frame with the ids of the objects in each pixel, which are not written to the root."""
    scene = RootScene(SEED, NUM_FRAMES, IMAGE_SIZE, MapLayout().place(0, SEED, NUM_FRAMES))
    return list(scene.frames())[FRAME]


@pytest.fixture(scope="module")
def sample(tables):
    scene = next(row for row in tables.rows["scene"] if row["name"] == NAMED)
    return [row for row in tables.rows["sample"] if row["scene_token"] == scene["token"]][FRAME]


def projected_box(tables, data, annotation, ego_pose=None) -> np.ndarray | None:
    """The corners (8, 2) [px] of an annotation in the image of a row of sample_data; None if one is behind it."""
    calibrated = tables.get("calibrated_sensor", data["calibrated_sensor_token"])
    global_T_camera = pose(ego_pose or tables.get("ego_pose", data["ego_pose_token"])) @ pose(calibrated)
    yaw = 2 * np.arctan2(annotation["rotation"][3], annotation["rotation"][0])
    box = np.array([[*annotation["translation"], *annotation["size"], yaw, 0, 0]])
    points = transform(inverse(global_T_camera), box_corners(box)[0])
    pixels = points @ np.array(calibrated["camera_intrinsic"]).T
    return pixels[:, :2] / pixels[:, 2:] if points[:, 2].min() > 0.5 else None


def test_the_pixels_of_each_object_are_in_its_projected_box_and_fill_it(tables, rendered, sample):
    annotations = {row["token"]: row for row in tables.annotations_of(sample)}
    checked = 0
    for channel, image in rendered.rendered.items():
        data = tables.data_of(sample)[channel]
        for item in rendered.objects:
            if item.identity not in rendered.identities:  # a rack, which is not rendered
                continue
            token = make_token("sample_annotation", NAMED, *item.identity, FRAME)
            rows, columns = np.nonzero(image.ids == rendered.identities.index(item.identity) + 1)
            if token not in annotations or len(rows) < 30 or item.visible_share < 0.99:
                continue
            pixels = projected_box(tables, data, annotations[token])
            if pixels is None:
                continue
            expected = np.array([pixels.min(axis=0), pixels.max(axis=0)]).clip(0, IMAGE_SIZE)
            actual = np.array([[columns.min(), rows.min()], [columns.max() + 1, rows.max() + 1]])
            assert np.maximum(expected[0] - actual[0], actual[1] - expected[1]).max() <= 1.5
            extent = expected[1] - expected[0]
            if (pixels.min(axis=0) >= 0).all() and (pixels.max(axis=0) <= IMAGE_SIZE).all():
                assert np.all(np.abs(actual - expected) <= 1.5 + 0.25 * extent), (channel, item.category)
                checked += 1
    assert checked >= 8


def test_the_images_in_the_root_are_the_rendered_ones(tables, rendered, sample):
    for channel, data in tables.data_of(sample).items():
        if channel != "LIDAR_TOP":
            written = cv2.imread(str(tables.root / data["filename"])).astype(int)
            assert np.abs(written - rendered.rendered[channel].image).mean() < 3  # JPEG


def test_the_ego_pose_of_a_camera_moves_boxes_by_pixels_against_that_of_the_key_frame(tables, sample):
    data = tables.data_of(sample)
    key_pose = tables.get("ego_pose", data["LIDAR_TOP"]["ego_pose_token"])
    shifts = []
    for annotation in tables.annotations_of(sample):
        own = projected_box(tables, data["CAM_FRONT_LEFT"], annotation)
        at_key = projected_box(tables, data["CAM_FRONT_LEFT"], annotation, key_pose)
        if (
            own is not None
            and at_key is not None
            and (own.min(axis=0) > 0).all()
            and (own.max(axis=0) < IMAGE_SIZE).all()
        ):
            shifts.append(np.abs(own - at_key).max())
    assert max(shifts) > 2


def test_ego_poses_move_with_the_speed_of_the_ego(tables, sample):
    data = tables.data_of(sample)
    first, last = (tables.get("ego_pose", data[name]["ego_pose_token"]) for name in ("CAM_FRONT_LEFT", "LIDAR_TOP"))
    moved = np.linalg.norm(np.subtract(last["translation"], first["translation"]))
    seconds = (last["timestamp"] - first["timestamp"]) * 1e-6
    following = tables.get("sample", sample["next"])
    later = tables.get("ego_pose", tables.data_of(following)["LIDAR_TOP"]["ego_pose_token"])
    speed = np.linalg.norm(np.subtract(later["translation"], last["translation"])) / (
        (later["timestamp"] - last["timestamp"]) * 1e-6
    )
    assert moved / seconds == pytest.approx(speed, rel=0.02)
