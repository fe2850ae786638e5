"""Builds the mesh of an object by its name: one of the ten classes, or "house", "tree" or "lamp"."""

import numpy as np

from .mesh import Mesh, MeshBuilder
from .person_meshes import add_bicycle, add_motorcycle, add_pedestrian
from .street_meshes import add_barrier, add_house, add_lamp, add_traffic_cone, add_tree
from .vehicle_meshes import add_bus, add_car, add_construction_vehicle, add_trailer, add_truck

ADD_FUNCTIONS = {
    "car": add_car,
    "truck": add_truck,
    "construction_vehicle": add_construction_vehicle,
    "bus": add_bus,
    "trailer": add_trailer,
    "barrier": add_barrier,
    "motorcycle": add_motorcycle,
    "bicycle": add_bicycle,
    "pedestrian": add_pedestrian,
    "traffic_cone": add_traffic_cone,
    "house": add_house,
    "tree": add_tree,
    "lamp": add_lamp,
}


def build_mesh(name: str, size_m: tuple[float, float, float], rng: np.random.Generator) -> Mesh:
    """Build the mesh of an object that fills a box.

    name: a class, or "house", "tree" or "lamp".
    size_m: width, length and height of the box.
    rng: chooses colours and variants.
    """
    builder = MeshBuilder(size_m)
    ADD_FUNCTIONS[name](builder, rng)
    return builder.build()
