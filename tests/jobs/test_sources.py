"""The grid on which sources rasterise their map masks."""

import numpy as np
import pytest

from duospacenet.data.mask_grid import MaskGrid
from duospacenet.jobs.sources import map_grid, open_source
from duospacenet.model import PRESETS
from duospacenet.model.config import VoxelGrid
from duospacenet.runtime.bundle.manifest import read_manifest
from tests.helpers.nuscenes_roots import write_small_root


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    return write_small_root(tmp_path_factory.mktemp("sources") / "root", 1, 1)


@pytest.fixture(autouse=True)
def cache_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("DUOSPACENET_CACHE", str(tmp_path / "cache"))


def test_the_grid_covers_the_perception_range_of_the_model(tiny_bundle):
    assert map_grid(PRESETS["base"].voxels, ["drivable_area"]) == MaskGrid((200, 200), (-51.2, -51.2), (51.2, 51.2))
    manifest = read_manifest(tiny_bundle)
    assert map_grid(manifest.perception, manifest.map_classes) == MaskGrid((16, 16))
    assert map_grid(manifest.perception, []) is None


@pytest.mark.parametrize("name", ["nano", "small", "base"])
def test_nuscenes_sources_have_masks_on_the_grid_of_any_preset(root, name):
    source = open_source(f"nuscenes:{root}", map_grid(PRESETS[name].voxels, PRESETS[name].map_classes))
    maps = source.frame(0).ground_truth.maps
    assert set(maps) == set(PRESETS[name].map_classes)
    assert all(mask.shape == PRESETS[name].voxels.size[:2] and mask.any() for mask in maps.values())


def test_a_smaller_range_shows_the_middle_of_a_larger_one(root):
    """Cells of the same size, so the masks are equal where they overlap."""
    whole = open_source(f"nuscenes:{root}", MaskGrid((128, 128))).frame(0).ground_truth.maps
    voxels = VoxelGrid((64, 32, 4), (-25.6, -12.8, -3.0), (25.6, 12.8, 5.0))
    part = open_source(f"nuscenes:{root}", map_grid(voxels, ["drivable_area"])).frame(0).ground_truth.maps
    for name, mask in part.items():
        assert mask.any()
        assert np.mean(mask != whole[name][32:96, 48:80]) < 0.02, name
