"""Projection into the cameras, against cases worked by hand."""

import math

import pytest
import torch

from duospacenet.model.projection import OUTSIDE, axis_centres, project, project_grid
from tests.helpers.model_inputs import ASYMMETRIC, normal, pinhole, rigid, ring_of_cameras

WIDTH_PX, HEIGHT_PX = 160, 64

# A camera at the origin that looks along x, with a focal length of 100 px and the principal point (80, 32).
AHEAD = torch.tensor(pinhole(100, (80, 32), rigid(0)))[None]


@pytest.mark.parametrize(
    ("point_m", "pixel_px"),
    [
        ((10, 0, 0), (80, 32)),
        ((10, 2, 0), (60, 32)),  # left in the world is left in the image
        ((10, 0, 1), (80, 22)),  # up in the world is up in the image
        ((20, -4, -2), (100, 42)),
        ((0.2, 0, 0), (80, 32)),
    ],
)
def test_a_point_is_projected_as_by_a_pinhole_camera(point_m, pixel_px):
    locations, visible = project(torch.tensor([point_m], dtype=torch.float32), AHEAD, WIDTH_PX, HEIGHT_PX)
    assert visible.tolist() == [[True]]
    torch.testing.assert_close(
        locations[0, :, 0] * torch.tensor([160.0, 64.0]), torch.tensor(pixel_px, dtype=torch.float32)
    )


@pytest.mark.parametrize(
    "point_m",
    [(-10, 0, 0), (0.0999, 0, 0), (0, 0, 0), (10, 8.01, 0), (10, -8.01, 0), (10, 0, 3.21), (10, 0, -3.21)],
)
def test_a_point_behind_too_near_or_beside_the_image_is_not_visible(point_m):
    locations, visible = project(torch.tensor([point_m]), AHEAD, WIDTH_PX, HEIGHT_PX)
    assert visible.tolist() == [[False]]
    assert locations.tolist() == [[[OUTSIDE], [OUTSIDE]]]


@pytest.mark.parametrize("point_m", [(0.1001, 0, 0), (10, 7.99, 0), (10, -7.99, 0), (10, 0, 3.19), (10, 0, -3.19)])
def test_a_point_just_inside_the_image_is_visible(point_m):
    assert project(torch.tensor([point_m]), AHEAD, WIDTH_PX, HEIGHT_PX)[1].tolist() == [[True]]


@pytest.mark.parametrize(
    ("point_m", "belongs"), [((10, 12.5, 0), True), ((10, 0, 5), True), ((10, -12.5, 0), False), ((10, 0, -5), False)]
)
def test_only_the_left_and_the_upper_border_belong_to_the_image(point_m, belongs):
    """With a focal length of 64 px these points are exactly on the borders of the 160×64 image."""
    camera = torch.tensor(pinhole(64, (80, 32), rigid(0)))[None]
    assert project(torch.tensor([point_m]), camera, WIDTH_PX, HEIGHT_PX)[1].tolist() == [[belongs]]


def test_every_camera_has_its_own_view():
    to_the_left = torch.tensor(pinhole(100, (80, 32), rigid(math.pi / 2, translation=(0, 1, 0))))[None]
    points = torch.tensor([[10.0, 0, 0], [1, 11, 0], [10, 10, 0]])
    locations, visible = project(points, torch.cat((AHEAD, to_the_left)), WIDTH_PX, HEIGHT_PX)
    assert visible.tolist() == [[True, False, False], [False, True, False]]
    torch.testing.assert_close(locations[1, :, 1], torch.tensor([90 / 160, 0.5]))  # 1 m to the right, 10 m away


def test_every_frame_is_projected_into_its_own_cameras():
    points = torch.tensor([[[10.0, 1, 0], [10, 2, 0], [10, 3, 0]], [[20, 1, 0], [20, 2, 0], [20, 3, 0]]] * 2)[:3]
    points[2] = torch.tensor([[30, 0, 1], [30, 3, 1], [30, 5, 1]])
    cameras = torch.stack([torch.cat((AHEAD, AHEAD * scale)) for scale in (1, 2, 3)])
    cameras[:, 1, 0] += torch.tensor([0.0, 5, 0, 0])  # px per metre to the left
    locations, visible = project(points, cameras, WIDTH_PX, HEIGHT_PX)
    assert locations.shape == (3, 2, 2, 3)
    for t in range(3):
        locations_alone, visible_alone = project(points[t], cameras[t], WIDTH_PX, HEIGHT_PX)
        assert torch.equal(locations[t], locations_alone)
        assert torch.equal(visible[t], visible_alone)


@pytest.mark.parametrize("broken", [0.0, float("nan"), float("inf")])
def test_no_point_is_visible_in_a_broken_camera(broken):
    locations, visible = project(torch.tensor([[10.0, 0, 0]]), torch.full((2, 3, 4), broken), WIDTH_PX, HEIGHT_PX)
    assert not visible.any()
    assert locations.eq(OUTSIDE).all()


# --- A grid of points ---------------------------------------------------------------------------------------------


def voxel_centres():
    """The centres (Z·X·Y, 3) [m] of the voxels; z varies slowest and y fastest."""
    x, y, z = axis_centres(ASYMMETRIC.voxels)
    return torch.stack([torch.stack((a, b, c)) for c in z for a in x for b in y])


@pytest.mark.parametrize("seed", range(8))
def test_a_grid_is_projected_as_its_points_bit_for_bit(seed):
    """Cameras around the ego, and any matrices."""
    any_matrices = normal(6, 3, 4, seed=seed) * torch.tensor([[100.0], [100.0], [1.0]])
    cameras = torch.cat((ring_of_cameras(6, WIDTH_PX, HEIGHT_PX, seed=seed), any_matrices))
    axes = axis_centres(ASYMMETRIC.voxels)
    locations, visible = project_grid(axes, cameras, WIDTH_PX, HEIGHT_PX)
    expected_locations, expected_visible = project(voxel_centres(), cameras, WIDTH_PX, HEIGHT_PX)
    assert torch.equal(visible, expected_visible)
    assert torch.equal(locations, expected_locations)
    assert visible[:6].any(dim=1).all()
    assert not visible.all(dim=1).any()


@pytest.mark.parametrize("broken", [0.0, float("nan"), float("inf")])
def test_no_voxel_is_visible_in_a_broken_camera(broken):
    cameras = torch.full((2, 3, 4), broken)
    locations, visible = project_grid(axis_centres(ASYMMETRIC.voxels), cameras, WIDTH_PX, HEIGHT_PX)
    assert not visible.any()
    assert locations.eq(OUTSIDE).all()
