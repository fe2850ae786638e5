"""Draws a scene into the cameras of a rig: sky, ground, shadows, then polygons from far to near.

Everything reaches the painter in the ego frame. Image coordinates follow the project's convention (the first
pixel's centre at 0.5); OpenCV draws with that centre at 0, so half a pixel is taken off at the last moment.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from ..runtime.frame import Camera
from ..runtime.geometry import box_corners, image_T_ego, inverse, project, transform
from .light import (
    GRAIN_PX_PER_M,
    GRAIN_TILE_PX,
    PANORAMA_PX_PER_DEG,
    PANORAMA_TOP_DEG,
    Light,
    paint_grain,
    paint_panorama,
    sample_light,
)
from .mesh import Mesh
from .polygons import Arrangement, Polygons, assemble, cut

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Counts = NDArray[np.int64]
Pixels = NDArray[np.int32]

SHIFT_BITS = 4  # OpenCV's fixed point: sixteenths of a pixel
NEAR_M = 0.2
SIDE_MARGIN = 0.1  # of the width; polygons are cut outside the image, where the cut is not seen
SMALLEST_PAINT_PX2 = 6.0
SMALLEST_SOLID_PX2 = 1.5
GRAIN_DEPTH_M = 22.0
SHADOW = 74  # brightness of the ground in shadow; 128 is unshaded
UP = np.array([[0.0, 0.0, 1.0]])

GROUND_COLOURS = {
    "grass": (62, 118, 100),
    "sidewalk": (148, 155, 160),
    "kerb": (182, 184, 184),
    "asphalt": (98, 96, 94),
    "white": (225, 228, 228),
    "yellow": (60, 175, 225),
}


class Picture(NamedTuple):
    """One camera's view of D boxes.

    image: (H, W, 3) uint8 BGR; ids: (H, W) uint16, 1 + the index of the box that is seen there, or 0;
    num_covered: (D,) pixels that each box would show if nothing stood before it.
    """

    image: Image
    ids: NDArray[np.uint16]
    num_covered: Counts


class Renderer:
    """Paints one drive with fixed cameras: its light, its sky and the ground's grain are drawn once."""

    def __init__(self, seed: int, cameras: Mapping[str, Camera]) -> None:
        rng = np.random.default_rng([seed, 6])
        self.light = sample_light(rng)
        self._grain = paint_grain(rng)
        lawn = self.light.shade(np.array([GROUND_COLOURS["grass"]]), UP, self.light.sun_direction)[0]
        self._panorama = paint_panorama(rng, self.light, lawn)
        self._views = {name: View(camera, self.light) for name, camera in cameras.items()}

    def paint(
        self,
        global_T_ego: Array,
        ground: Sequence[tuple[str, Array]],
        boxes: Array,
        meshes: Sequence[Mesh],
    ) -> dict[str, Picture]:
        """Draw ground outlines (k, 2) by kind, later over earlier, and meshes in their boxes (D, 9)."""
        sun_direction = global_T_ego[:3, :3].T @ self.light.sun_direction
        polygons = self._light_up(assemble(boxes, meshes), boxes, sun_direction)
        ground_colours = self._ground_colours(sun_direction)
        colours = [ground_colours[kind] for kind, _ in ground]
        shadows = _shadows(boxes, sun_direction, self.light.sun)
        outlines = _flatten([*(outline for _, outline in ground), *shadows])
        arrangement = Arrangement(boxes)
        pictures = {}
        for name, view in self._views.items():
            image = view.background(self._panorama, global_T_ego, ground_colours["grass"])
            view.ground(image, outlines, colours, view.grain(self._grain, global_T_ego))
            pictures[name] = view.objects(image, polygons, boxes, arrangement)
        return pictures

    def _light_up(self, polygons: Polygons, boxes: Array, sun_direction: Array) -> Polygons:
        distances = np.hypot(boxes[:, 0], boxes[:, 1])[polygons.owners]
        lit = self.light.shade(polygons.colours, polygons.normals, sun_direction)
        return polygons._replace(colours=self.light.veil(lit, distances))

    def _ground_colours(self, sun_direction: Array) -> dict[str, tuple[float, ...]]:
        colours = np.array(list(GROUND_COLOURS.values()), dtype=np.float64)
        lit = self.light.shade(colours, np.repeat(UP, len(colours), axis=0), sun_direction).clip(0, 255)
        return dict(zip(GROUND_COLOURS, map(tuple, lit.tolist()), strict=True))


class View:
    """One camera, with what only depends on its calibration: haze and directions of its pixels."""

    def __init__(self, camera: Camera, light: Light) -> None:
        self._camera = camera
        self._size = (camera.width_px, camera.height_px)
        self._image_T_ego = image_T_ego(camera.intrinsics_px, camera.camera_T_ego)
        self._eye = inverse(camera.camera_T_ego)[:3, 3]
        self._planes = _clip_planes(camera)
        rays = self._rays()
        downward = np.maximum(-rays[..., 2], 1e-9)
        distance_m = self._eye[2] / downward * np.linalg.norm(rays[..., :2], axis=-1)
        is_ground = rays[..., 2] < 0
        self._first_row = int(np.argmax(is_ground.any(axis=1)))
        self._sky_end = int(np.argmax(is_ground.all(axis=1)))
        below = slice(self._first_row, None)
        kept = np.where(is_ground, np.exp(-distance_m / light.haze_distance_m), 1.0)[below]
        self._kept = (255 * kept).round().astype(np.uint8)
        self._haze = ((1 - kept)[..., None] * light.haze).round().astype(np.uint8)
        grain = (255 * np.where(is_ground, np.exp(-distance_m / GRAIN_DEPTH_M), 0.0)[below]).round()
        self._grain_kept, self._grain_rest = grain.astype(np.uint8), ((255 - grain) * 128 / 255).astype(np.uint8)
        azimuth_deg = np.degrees(np.arctan2(rays[..., 1], rays[..., 0]))[: self._sky_end]
        self._panorama_columns = (azimuth_deg * PANORAMA_PX_PER_DEG).astype(np.float32)
        elevation_deg = np.degrees(np.arctan2(rays[..., 2], np.linalg.norm(rays[..., :2], axis=-1)))
        rows = (PANORAMA_TOP_DEG - elevation_deg[: self._sky_end]) * PANORAMA_PX_PER_DEG - 0.5
        self._panorama_rows = np.maximum(rows, 0).astype(np.float32)

    def _rays(self) -> Array:
        """The direction (H, W, 3) in the ego frame of each pixel's centre."""
        u, v = np.meshgrid(np.arange(self._size[0]) + 0.5, np.arange(self._size[1]) + 0.5)
        pixels = np.stack([u, v, np.ones_like(u)], axis=-1)
        return pixels @ np.linalg.inv(self._camera.intrinsics_px).T @ self._camera.camera_T_ego[:3, :3]

    def background(self, panorama: Image, global_T_ego: Array, lawn: tuple[float, ...]) -> Image:
        """Sky down to the horizon and grass below it."""
        image = np.empty((self._size[1], self._size[0], 3), dtype=np.uint8)
        cv2.rectangle(image, (0, self._sky_end), self._size, lawn, cv2.FILLED)
        if self._sky_end:
            heading_deg = np.degrees(np.arctan2(global_T_ego[1, 0], global_T_ego[0, 0]))
            columns = self._panorama_columns + np.float32(heading_deg * PANORAMA_PX_PER_DEG)
            image[: self._sky_end] = cv2.remap(
                panorama, columns, self._panorama_rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP
            )
        return image

    def grain(self, tile: Image, global_T_ego: Array) -> Image:
        """The brightness of the ground in the rows from the horizon down; it fades into 128 with distance."""
        rows = cv2.warpPerspective(
            tile,
            np.linalg.inv(self._rows_T_grain(global_T_ego)),
            self._kept.shape[::-1],
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_WRAP,
        )
        faded = cv2.multiply(rows, self._grain_kept, scale=1 / 255)
        return np.asarray(cv2.add(faded, self._grain_rest), dtype=np.uint8)

    def ground(
        self,
        image: Image,
        outlines: tuple[Array, Counts],
        colours: Sequence[tuple[float, ...]],
        brightness: Image,
    ) -> None:
        """Draw ground outlines (V, 3), (F,): the first in the colours given, the others as shadows; then haze."""
        horizon = np.array([0, self._first_row << SHIFT_BITS], dtype=np.int32)
        for outline, source in zip(*self._outlines(*outlines), strict=True):
            if source < len(colours):
                cv2.fillPoly(image, [outline], colours[source], cv2.LINE_AA, SHIFT_BITS)
            else:
                cv2.fillConvexPoly(brightness, outline - horizon, SHADOW, cv2.LINE_AA, SHIFT_BITS)
        gain = cv2.merge([cv2.multiply(brightness, self._kept, scale=1 / 255)] * 3)
        rows = image[self._first_row :]
        rows[:] = cv2.add(cv2.multiply(rows, gain, scale=1 / 128), self._haze)

    def _rows_T_grain(self, global_T_ego: Array) -> Array:
        """The homography (3, 3) from the grain's tile to the image's rows from the horizon down."""
        tile_m = GRAIN_TILE_PX / GRAIN_PX_PER_M
        corner_m = np.floor(global_T_ego[:2, 3] / tile_m) * tile_m
        global_T_grain = np.array(
            [[1 / GRAIN_PX_PER_M, 0, corner_m[0]], [0, 1 / GRAIN_PX_PER_M, corner_m[1]], [0, 0, 1]]
        )
        ego_T_global = inverse(global_T_ego)[np.ix_((0, 1, 3), (0, 1, 3))]
        rows_T_image = np.array([[1, 0, -0.5], [0, 1, -0.5 - self._first_row], [0, 0, 1]])
        return rows_T_image @ self._image_T_ego[:, [0, 1, 3]] @ ego_T_global @ global_T_grain

    def objects(self, image: Image, polygons: Polygons, boxes: Array, arrangement: Arrangement) -> Picture:
        """Draw objects, the nearest last, and what is seen of each."""
        ids = np.zeros(image.shape[:2], dtype=np.uint16)
        num_covered = np.zeros(len(boxes), dtype=np.int64)
        in_view = self._may_see(boxes)
        polygons = polygons.select(in_view[polygons.owners] & self._is_seen(polygons))
        ranks = self._ranks(in_view, arrangement)[polygons.owners]
        part_distances = np.linalg.norm(polygons.part_centres - self._eye, axis=1)
        outlines, sources = self._outlines(polygons.points, polygons.counts)
        order = np.lexsort((-part_distances[sources], ranks[sources]))
        outlines, sources = [outlines[i] for i in order.tolist()], sources[order]
        owners, solid = polygons.owners[sources], polygons.solid[sources].tolist()
        colours = polygons.colours[sources].tolist()
        runs = np.flatnonzero(np.diff(owners, prepend=-1)).tolist()
        regions = self._regions(boxes[owners[runs]])
        for first, end, region in zip(runs, [*runs, len(order)][1:], regions, strict=True):
            identity = int(owners[first]) + 1
            for face in range(first, end):
                cv2.fillConvexPoly(image, outlines[face], colours[face], cv2.LINE_AA, SHIFT_BITS)
                if solid[face]:
                    cv2.fillConvexPoly(ids, outlines[face], identity, cv2.LINE_8, SHIFT_BITS)
            num_covered[identity - 1] = np.count_nonzero(ids[region] == identity)
        return Picture(image, ids, num_covered)

    def _outlines(self, points: Array, counts: Counts) -> tuple[list[Pixels], Counts]:
        """Project polygons (V, 3), (F,) of the ego frame.

        Returns F' outlines in OpenCV's fixed-point pixels, and which polygon each one is or is left of.
        """
        if not len(counts):
            return [], np.zeros(0, dtype=np.int64)
        pieces = cut(transform(self._camera.camera_T_ego, points), counts, self._planes)
        homogeneous = pieces.points @ self._camera.intrinsics_px.T
        pixels = homogeneous[:, :2] / np.maximum(homogeneous[:, 2:], NEAR_M) - 0.5
        fixed = np.rint(pixels * (1 << SHIFT_BITS)).astype(np.int32)
        starts, ends = pieces.starts.tolist(), (pieces.starts + pieces.counts).tolist()
        return [fixed[start:end] for start, end in zip(starts, ends, strict=True)], pieces.sources

    def _may_see(self, boxes: Array) -> NDArray[np.bool_]:
        """(D,) whether a ball round each box reaches into the camera's field of view."""
        centres = np.column_stack([boxes[:, :3], np.ones(len(boxes))]) @ self._camera.camera_T_ego[:3].T
        planes = self._planes / np.linalg.norm(self._planes[:, :3], axis=1, keepdims=True)
        distances = centres @ planes[:, :3].T + planes[:, 3]
        return (distances > -np.linalg.norm(boxes[:, 3:6], axis=1)[:, None] / 2).all(axis=1)

    def _is_seen(self, polygons: Polygons) -> NDArray[np.bool_]:
        """(F,) whether a polygon faces the eye and covers enough of the picture to be drawn."""
        areas_px2 = polygons.apparent_areas(self._eye) * self._camera.intrinsics_px[0, 0] ** 2
        return areas_px2 > np.where(polygons.solid, SMALLEST_SOLID_PX2, SMALLEST_PAINT_PX2)

    def _regions(self, boxes: Array) -> list[tuple[slice, slice]]:
        """The rows and columns that hold each box (D, 9), and a little more."""
        pixels, depths = project(box_corners(boxes), self._image_T_ego)
        start, end = pixels.min(axis=1) - 2, pixels.max(axis=1) + 2
        is_cut = depths.min(axis=1) < NEAR_M
        start[is_cut], end[is_cut] = 0, self._size
        start, end = np.clip(start, 0, self._size).astype(int), np.clip(end, 0, self._size).astype(int)
        return [(slice(v0, v1), slice(u0, u1)) for (u0, v0), (u1, v1) in zip(start.tolist(), end.tolist(), strict=True)]

    def _ranks(self, in_view: NDArray[np.bool_], arrangement: Arrangement) -> Counts:
        """(D,) the place of each object in view in the order from far to near."""
        ranks = np.zeros(len(in_view), dtype=np.int64)
        order = arrangement.far_to_near(np.flatnonzero(in_view), self._eye[:2])
        ranks[order] = np.arange(len(order))
        return ranks


def _clip_planes(camera: Camera) -> Array:
    """Planes (3, 4) of the camera frame: left, right, near."""
    focal, centre = camera.intrinsics_px[0, 0], camera.intrinsics_px[0, 2]
    margin = SIDE_MARGIN * camera.width_px
    return np.array(
        [
            [focal, 0, centre + margin, 0],
            [-focal, 0, camera.width_px + margin - centre, 0],
            [0, 0, 1, -NEAR_M],
        ]
    )


def _flatten(outlines: Sequence[Array]) -> tuple[Array, Counts]:
    """Ground outlines (k, 2) as one array of points (V, 3) at z = 0 and their counts (F,)."""
    points = np.concatenate(outlines) if outlines else np.zeros((0, 2))
    return np.column_stack([points, np.zeros(len(points))]), np.array([len(o) for o in outlines], dtype=np.int64)


def _shadows(boxes: Array, sun_direction: Array, sun: float) -> list[Array]:
    """Outlines (k, 2) of the shadows of boxes (D, 9); without sun they stay below the box."""
    corners = box_corners(boxes)
    reach = -sun_direction[:2] / sun_direction[2] * min(1.0, 2 * sun)
    fallen = corners[..., :2] + corners[..., 2:] * reach
    return [cv2.convexHull(outline.astype(np.float32))[:, 0].astype(np.float64) for outline in fallen]
