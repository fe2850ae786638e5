"""Objects are rendered where their boxes are."""

import numpy as np
import pytest

from duospacenet.runtime.geometry import rigid_transform, rotation_z
from duospacenet.synthetic.class_sizes import CLASS_SIZES_M
from duospacenet.synthetic.object_meshes import build_mesh
from tests.helpers.synthetic_scenes import ASPHALT, CLASS_ORDER, box_at, corners_px, render, renderer_for

BOX_SHAPED = ("truck", "bus", "trailer", "barrier", "car")


@pytest.mark.parametrize("name", CLASS_ORDER)
@pytest.mark.parametrize(
    ("camera_name", "x", "y"), [("CAM_FRONT", 18.0, 1.5), ("CAM_FRONT_LEFT", 12.0, 17.0), ("CAM_BACK", -14.0, -3.0)]
)
@pytest.mark.parametrize("yaw", [0.0, 0.7, 2.6])
def test_a_rendered_object_fills_its_projected_box(name, camera_name, x, y, yaw):
    box = box_at(name, x, y, yaw)
    rendered, cameras = render((800, 320), [name], [box])
    pixels = corners_px(cameras[camera_name], box)
    expected = np.array([pixels.min(axis=0), pixels.max(axis=0)]).clip(0, (800, 320))
    rows, columns = np.nonzero(rendered[camera_name].ids == 1)
    actual = np.array([[columns.min(), rows.min()], [columns.max() + 1, rows.max() + 1]])
    outside = np.maximum(expected[0] - actual[0], actual[1] - expected[1])
    assert np.all(outside <= 1.5)
    missing = np.maximum(actual[0] - expected[0], expected[1] - actual[1])
    extent = expected[1] - expected[0]
    assert np.all(missing <= 1.5 + (0.12 if name in BOX_SHAPED else 0.25) * extent)


@pytest.mark.parametrize("name", ["bus", "trailer"])
@pytest.mark.parametrize(("camera_name", "x", "y"), [("CAM_FRONT", 27.0, 1.0), ("CAM_BACK_RIGHT", -12.0, -22.0)])
def test_colours_change_exactly_where_a_tall_box_is_in_front_of_the_sky(name, camera_name, x, y):
    other, box = box_at("traffic_cone", -x, -y), box_at(name, x, y, 0.5)
    rendered, cameras = render((400, 160), ["traffic_cone"], [other])
    before = rendered[camera_name].image
    after = render((400, 160), ["traffic_cone", name], [other, box])[0][camera_name].image
    horizon = int(cameras[camera_name].intrinsics_px[1, 2]) - 6  # shadows are below it
    change = np.abs(after.astype(int) - before).max(axis=2)[:horizon]
    rows, columns = np.nonzero(change > np.median(change[change > 0]) / 2)
    pixels = corners_px(cameras[camera_name], box)
    assert abs(columns.min() - pixels[:, 0].min()) < 1.5
    assert abs(columns.max() + 1 - pixels[:, 0].max()) < 1.5
    assert abs(rows.min() - pixels[:, 1].min()) < 1.5


def test_objects_are_rendered_without_a_shift_of_half_a_pixel():
    errors = []
    for offset in np.linspace(-2.0, 2.0, 12):
        box = box_at("trailer", 30.0 + offset, offset, 0.0)
        rendered, cameras = render((800, 320), ["trailer"], [box])
        rows, columns = np.nonzero(rendered["CAM_FRONT"].ids == 1)
        pixels = corners_px(cameras["CAM_FRONT"], box)
        centre = np.array([columns.min() + columns.max() + 1, rows.min() + rows.max() + 1]) / 2
        errors.append(centre - (pixels.min(axis=0) + pixels.max(axis=0)) / 2)
    assert np.all(np.abs(np.mean(errors, axis=0)) < 0.2)


def test_objects_are_rendered_into_the_same_pixels_for_any_ego_pose():
    renderer, cameras = renderer_for((400, 160))
    box, mesh = box_at("bus", 18.0, 4.0, 0.4), build_mesh("bus", CLASS_SIZES_M["bus"], np.random.default_rng(0))
    here = renderer.render(np.eye(4), ASPHALT, box[None], [mesh])
    there = renderer.render(rigid_transform(rotation_z(2.0), [812.0, -333.0, 0.0]), ASPHALT, box[None], [mesh])
    assert here["CAM_FRONT"].ids.any()
    assert all(np.array_equal(here[name].ids, there[name].ids) for name in cameras)
