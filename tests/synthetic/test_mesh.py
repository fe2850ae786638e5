"""The builder of meshes, by hand-worked cases."""

import numpy as np

from duospacenet.synthetic.mesh import MeshBuilder, rectangle

GREY = (100.0, 100.0, 100.0)


def test_a_box_has_a_top_and_four_sides_that_face_outwards():
    builder = MeshBuilder((2.0, 5.0, 3.0))
    builder.add_frustum(rectangle(-0.5, 0.5, 0.5, 0.0), rectangle(-0.5, 0.5, 0.5, 1.0), GREY)
    mesh = builder.build()
    assert mesh.normals.tolist() == [[0, 0, 1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]]
    assert mesh.areas.tolist() == [10, 6, 6, 15, 15]
    assert mesh.solid.all()


def test_a_decal_covers_its_share_of_a_quad_and_is_not_solid():
    builder = MeshBuilder((2.0, 5.0, 3.0))
    front, *_ = builder.add_frustum(rectangle(-0.5, 0.5, 0.5, 0.0), rectangle(-0.5, 0.5, 0.5, 1.0), GREY)
    builder.add_decal(front, 0.0, 0.5, 0.5, 1.0, GREY)
    mesh = builder.build()
    # Seen from outside, the left of a front is at -y: u goes from -y to +y, and v goes up.
    assert mesh.points[-4:].tolist() == [[2.5, -1, 1.5], [2.5, 0, 1.5], [2.5, 0, 3], [2.5, -1, 3]]
    assert mesh.solid.tolist() == [True] * 5 + [False]


def test_polygons_have_the_centre_of_their_part():
    builder = MeshBuilder((1.0, 1.0, 1.0))
    builder.add_polygon([(0, 0, 0), (0.2, 0, 0), (0.2, 0.2, 0), (0, 0.2, 0)], GREY)
    builder.start_part()
    builder.add_polygon([(0, 0, 0.5), (0.4, 0, 0.5), (0.4, 0.4, 0.5), (0, 0.4, 0.5)], GREY)
    np.testing.assert_allclose(builder.build().part_centres, [[0.1, 0.1, 0.0], [0.2, 0.2, 0.5]])
