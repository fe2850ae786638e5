"""Meshes fill the boxes of their objects."""

import numpy as np
import pytest

from duospacenet.synthetic.class_sizes import CLASS_SIZES_M
from duospacenet.synthetic.object_meshes import ADD_FUNCTIONS, build_mesh


@pytest.mark.parametrize("name", ADD_FUNCTIONS)
def test_a_mesh_fills_its_box_and_does_not_leave_it(name):
    width, length, height = CLASS_SIZES_M.get(name, (3.0, 3.0, 6.0))
    mesh = build_mesh(name, (width, length, height), np.random.default_rng(0))
    low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
    extent = np.array([length, width, height])
    assert (low >= np.array([-length / 2, -width / 2, 0.0]) - 1e-9).all()
    assert (high <= np.array([length / 2, width / 2, height]) + 1e-9).all()
    assert (high - low >= 0.7 * extent).all()


@pytest.mark.parametrize("name", ADD_FUNCTIONS)
def test_normals_have_unit_length_and_areas_are_positive(name):
    mesh = build_mesh(name, (2.0, 5.0, 3.0), np.random.default_rng(0))
    assert len(mesh.counts) == len(mesh.normals) == len(mesh.areas) == len(mesh.colours)
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1.0)
    assert (mesh.areas > 0).all()
    assert mesh.counts.sum() == len(mesh.points)
