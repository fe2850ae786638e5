"""Renders ground and objects into all cameras of a rig."""

from collections.abc import Collection, Mapping, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from ..runtime.frame import Camera
from ..runtime.geometry import box_corners
from .camera_renderer import CameraRenderer, RenderedImage
from .light import sample_light
from .mesh import Mesh
from .occlusion_order import OcclusionOrder
from .polygons import Polygons, assemble_polygons
from .textures import ground_grain, sky_panorama

Array = NDArray[np.float64]
Counts = NDArray[np.int64]

UP = np.array([[0.0, 0.0, 1.0]])
GROUND_COLOURS = {
    "grass": (62, 118, 100),
    "sidewalk": (148, 155, 160),
    "kerb": (182, 184, 184),
    "asphalt": (98, 96, 94),
    "white": (225, 228, 228),
    "yellow": (60, 175, 225),
}


class Renderer:
    """Renders the frames of one drive with fixed cameras. Light and textures are sampled once, from the seed."""

    def __init__(self, seed: int, cameras: Mapping[str, Camera]) -> None:
        rng = np.random.default_rng([seed, 6])
        self._light = sample_light(rng)
        self._grain = ground_grain(rng)
        grass = self._light.shade(np.array([GROUND_COLOURS["grass"]]), UP, self._light.sun_direction)[0]
        self._panorama = sky_panorama(rng, self._light, grass)
        self._cameras = {name: CameraRenderer(camera, self._light) for name, camera in cameras.items()}

    def render(
        self,
        global_T_ego: Array,
        ground: Sequence[tuple[str, Array]],
        boxes: Array,
        meshes: Sequence[Mesh],
        names: Collection[str] | None = None,
    ) -> dict[str, RenderedImage]:
        """Render the ground and D objects into the cameras.

        global_T_ego: (4, 4).
        ground: kind and outline (k, 2) [m] of each area, in the ego frame. The kinds are the keys of `GROUND_COLOURS`.
            Later areas cover earlier ones.
        boxes: (D, 9) in the ego frame. They must not overlap.
        meshes: one per box.
        names: the cameras to render; all if None.

        Returns the rendered image of each camera by name.
        """
        sun_direction = global_T_ego[:3, :3].T @ self._light.sun_direction
        polygons = self._apply_light(assemble_polygons(boxes, meshes), boxes, sun_direction)
        ground_colours = self._ground_colours(sun_direction)
        colours = [ground_colours[kind] for kind, _ in ground]
        shadows = _shadows(boxes, sun_direction, self._light.sun)
        outlines = _flatten([*(outline for _, outline in ground), *shadows])
        occlusion_order = OcclusionOrder(boxes)
        rendered = {}
        for name in self._cameras if names is None else names:
            camera = self._cameras[name]
            image = camera.render_background(self._panorama, global_T_ego, ground_colours["grass"])
            camera.render_ground(image, outlines, colours, camera.ground_brightness(self._grain, global_T_ego))
            rendered[name] = camera.render_objects(image, polygons, boxes, occlusion_order)
        return rendered

    def _apply_light(self, polygons: Polygons, boxes: Array, sun_direction: Array) -> Polygons:
        distances = np.hypot(boxes[:, 0], boxes[:, 1])[polygons.owners]
        lit = self._light.shade(polygons.colours, polygons.normals, sun_direction)
        return polygons._replace(colours=self._light.add_haze(lit, distances))

    def _ground_colours(self, sun_direction: Array) -> dict[str, tuple[float, ...]]:
        colours = np.array(list(GROUND_COLOURS.values()), dtype=np.float64)
        lit = self._light.shade(colours, np.repeat(UP, len(colours), axis=0), sun_direction).clip(0, 255)
        return dict(zip(GROUND_COLOURS, map(tuple, lit.tolist()), strict=True))


def _flatten(outlines: Sequence[Array]) -> tuple[Array, Counts]:
    """The points (V, 3) of all outlines (k, 2), at z = 0, and the number of points (F,) of each outline."""
    points = np.concatenate(outlines) if outlines else np.zeros((0, 2))
    return np.column_stack([points, np.zeros(len(points))]), np.array([len(o) for o in outlines], dtype=np.int64)


def _shadows(boxes: Array, sun_direction: Array, sun: float) -> list[Array]:
    """Outlines (k, 2) [m] of the shadows of boxes (D, 9) on the ground.

    sun: factor of the direct sunlight. Weak sunlight gives short shadows.
    """
    corners = box_corners(boxes)
    reach = -sun_direction[:2] / sun_direction[2] * min(1.0, 2 * sun)
    projected = corners[..., :2] + corners[..., 2:] * reach
    return [cv2.convexHull(outline.astype(np.float32))[:, 0].astype(np.float64) for outline in projected]
