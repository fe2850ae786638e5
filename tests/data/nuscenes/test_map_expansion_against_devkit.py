"""The same maps, rasterised by this toolkit and by the map API of nuscenes-devkit 1.2.0.

The devkit moves positions to whole cells, by up to one cell, and fills every cell that an edge touches after that. Ours
decides by the centre of each cell. So the masks differ in a border of one cell, in a few places of two. On cells ten
times as small, where moving hardly matters, the devkit's mask at the centres of our cells is ours. The devkit also cuts
lines off at the edge of the mask, so a line just outside does not reach in with its width.
"""

import base64
import json

import cv2
import numpy as np
import pytest

from duospacenet.data.mask_grid import MaskGrid
from duospacenet.data.nuscenes.map_expansion import MapExpansion
from duospacenet.runtime.geometry import rigid_transform, rotation_z
from tests.helpers.devkit import run_devkit
from tests.helpers.map_files import MapFile, rectangle
from tests.helpers.nuscenes_roots import PlainTables, write_small_root

BOSTON = "boston-seaport"
FINE = 10  # cells of the fine mask per cell and axis

pytestmark = pytest.mark.slow


def curve(radius_m, number=60):
    """A closed wavy outline around (1000, 1000)."""
    angles = np.linspace(0, 2 * np.pi, number, endpoint=False)
    radii = radius_m * (1 + 0.1 * np.sin(5 * angles))
    return 1000 + np.stack([radii * np.cos(angles), radii * np.sin(angles)], axis=1)


def handmade_root(folder):
    """A ring road with an island in it, two squares that overlap, and lines."""
    file = MapFile()
    file.add_drivable_area([curve(40.0), curve(25.0), rectangle(1027, 1000, 1031, 1006)])
    file.add_drivable_area([rectangle(990, 1005, 1012, 1020)], [rectangle(1005, 1000, 1015, 1015)])
    file.add_divider("road_divider", curve(33.0))
    file.add_divider("lane_divider", [(960, 990), (1000, 1000.3), (1040, 990)])
    file.write(folder)
    return folder, [(1000, 1000, 0.0), (1012, 985, 37.0), (980.3, 1020.7, -160.0)]


def synthetic_root(folder):
    """The root of a synthetic scene, and its ego poses."""
    root = write_small_root(folder / "root", 1, 4, seed=12)
    tables = PlainTables(root)
    poses = []
    for sample in tables.rows["sample"]:
        row = tables.get("ego_pose", tables.data_of(sample)["LIDAR_TOP"]["ego_pose_token"])
        w, _, _, z = row["rotation"]
        poses.append((*row["translation"][:2], float(np.degrees(2 * np.arctan2(z, w)))))
    return root, poses


@pytest.fixture(scope="module", params=[handmade_root, synthetic_root])
def root(request, tmp_path_factory):
    """The folder of a root with a map of Boston, and poses [x, y, yaw in degrees] in it."""
    return request.param(tmp_path_factory.mktemp("maps"))


def devkit_masks(root, size, *layers):
    """The masks (X, Y) of the devkit, one list of layers per pose."""
    folder, poses = root
    printed = run_devkit("map_masks.py", folder, BOSTON, json.dumps(poses), size, *layers)
    bits = [[np.frombuffer(base64.b64decode(layer), np.uint8) for layer in masks] for masks in printed]
    return [
        [np.unpackbits(layer)[: size * size].reshape(size, size).T.astype(bool) for layer in masks] for masks in bits
    ]


def our_masks(root, size):
    folder, poses = root
    maps, grid = MapExpansion(folder, [BOSTON]), MaskGrid((size, size))
    transforms = [rigid_transform(rotation_z(np.radians(yaw)), [x, y, 0.0]) for x, y, yaw in poses]
    return [maps.masks(BOSTON, pose, grid) for pose in transforms]


def border(mask, cells=1):
    """The cells that have the other value within a number of cells in x and y."""
    kernel = np.ones((2 * cells + 1, 2 * cells + 1), np.uint8)
    return cv2.dilate(mask.astype(np.uint8), kernel) != cv2.erode(mask.astype(np.uint8), kernel)


@pytest.mark.parametrize("size", [200, 64])
def test_the_drivable_area_is_that_of_the_devkit_at_the_centre_of_each_cell(root, size):
    fine = devkit_masks(root, size * FINE, "drivable_area")
    for (expected,), masks in zip(fine, our_masks(root, size), strict=True):
        actual = masks["drivable_area"]
        differs = actual != expected[FINE // 2 :: FINE, FINE // 2 :: FINE]
        assert 0.1 < actual.mean() < 0.9
        assert differs.sum() <= 0.05 * border(actual).sum()  # centres within a few centimetres of an edge
        assert not (differs & ~border(actual)).any()


def check_close(actual, expected):
    """The masks differ within one cell of an edge, and in less than 2 % of the border within two."""
    differs = actual != expected
    differs[[0, 1, -2, -1]] = differs[:, [0, 1, -2, -1]] = False
    for mask in (actual, expected):
        assert not (differs & ~border(mask, cells=2)).any()
        assert (differs & ~border(mask)).sum() < 0.02 * border(mask).sum()


def test_the_drivable_area_on_200_cells_is_that_of_the_devkit_but_for_its_border(root):
    for (expected,), masks in zip(devkit_masks(root, 200, "drivable_area"), our_masks(root, 200), strict=True):
        check_close(masks["drivable_area"], expected)


def test_lane_boundaries_on_200_cells_are_those_of_the_devkit_but_for_their_border(root):
    expected_masks = devkit_masks(root, 200, "lane_divider", "road_divider")
    for expected, masks in zip(expected_masks, our_masks(root, 200), strict=True):
        lines = expected[0] | expected[1]
        assert masks["lane_boundary"].sum() == pytest.approx(lines.sum(), rel=0.06)
        check_close(masks["lane_boundary"], lines)
