"""Single objects on a plain asphalt ground, rendered into the cameras of a rig."""

from functools import cache

import numpy as np

from duospacenet.runtime.frame import Camera
from duospacenet.runtime.geometry import box_corners, image_T_ego, project
from duospacenet.synthetic.camera_renderer import RenderedImage
from duospacenet.synthetic.class_sizes import CLASS_SIZES_M
from duospacenet.synthetic.nuscenes_rig import build_rig
from duospacenet.synthetic.object_meshes import build_mesh
from duospacenet.synthetic.renderer import Renderer

ASPHALT = [("asphalt", np.array([[-90.0, -90.0], [90.0, -90.0], [90.0, 90.0], [-90.0, 90.0]]))]
CLASS_ORDER = (
    "car", "truck", "construction_vehicle", "bus", "trailer", "barrier", "motorcycle", "bicycle", "pedestrian",
    "traffic_cone",
)  # fmt: skip


def box_at(name: str, x: float, y: float, yaw: float = 0.0) -> np.ndarray:
    """The box (9,) of an object of typical size on the ground."""
    w, l, h = CLASS_SIZES_M[name]  # noqa: E741
    return np.array([x, y, h / 2, w, l, h, yaw, 0.0, 0.0])


@cache
def renderer_for(image_size: tuple[int, int]) -> tuple[Renderer, dict[str, Camera]]:
    cameras = build_rig(3, image_size)
    return Renderer(3, cameras), cameras


def render(image_size, names, boxes) -> tuple[dict[str, RenderedImage], dict[str, Camera]]:
    """The images of objects in their boxes, and the cameras."""
    renderer, cameras = renderer_for(image_size)
    sizes = [tuple(box[3:6]) for box in boxes]
    meshes = [build_mesh(name, size, np.random.default_rng(0)) for name, size in zip(names, sizes, strict=True)]
    return renderer.render(np.eye(4), ASPHALT, np.array(boxes), meshes), cameras


def corners_px(camera: Camera, box: np.ndarray) -> np.ndarray:
    """The corners (8, 2) of a box in pixels."""
    return project(box_corners(box)[0], image_T_ego(camera.intrinsics_px, camera.camera_T_ego))[0]
