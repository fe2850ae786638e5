"""Rendering into one camera: sky, ground with shadows, then objects from far to near.

Everything is given in the ego frame. Image coordinates follow the convention of the toolkit: the centre of the first
pixel is (0.5, 0.5). In OpenCV it is (0, 0), so 0.5 is subtracted just before OpenCV is called.
"""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from ..runtime.frame import Camera
from ..runtime.geometry import box_corners, image_T_ego, inverse, project, transform
from .light import Light
from .occlusion_order import OcclusionOrder
from .polygon_clipping import clip_polygons
from .polygons import Polygons
from .textures import GRAIN_PX_PER_M, GRAIN_TILE_PX, PANORAMA_PX_PER_DEG, PANORAMA_TOP_DEG

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Counts = NDArray[np.int64]
Pixels = NDArray[np.int32]

SHIFT_BITS = 4  # OpenCV takes positions in fixed point: sixteenths of a pixel
NEAR_M = 0.2
SIDE_MARGIN = 0.1  # of the width: polygons are clipped outside the image, where the new edge is not visible
SMALLEST_DECAL_PX2 = 6.0  # smaller decals and polygons are not rendered
SMALLEST_SOLID_PX2 = 1.5
GRAIN_DEPTH_M = 22.0  # distance at which 1/e of the contrast of the grain remains
SHADOW = 74  # brightness of ground in shadow; 128 is unshaded


class RenderedImage(NamedTuple):
    """The image of one camera, and the pixels of D boxes in it.

    image: (H, W, 3) uint8 BGR.
    ids: (H, W) uint16, 1 + the index of the visible box, or 0.
    num_unoccluded: (D,) pixels of each box if no other object were in front of it.
    """

    image: Image
    ids: NDArray[np.uint16]
    num_unoccluded: Counts


class CameraRenderer:
    """Renders into one camera. The haze and the direction of each pixel are computed once, from the calibration."""

    def __init__(self, camera: Camera, light: Light) -> None:
        self._camera = camera
        self._size = (camera.width_px, camera.height_px)
        self._image_T_ego = image_T_ego(camera.intrinsics_px, camera.camera_T_ego)
        self._eye = inverse(camera.camera_T_ego)[:3, 3]
        self._planes = _clip_planes(camera)
        rays = self._rays()
        self._prepare_ground(rays, light)
        self._prepare_sky(rays)

    def render_background(self, panorama: Image, global_T_ego: Array, grass: tuple[float, ...]) -> Image:
        """Render the sky above the horizon and grass below it.

        panorama: from `sky_panorama`.
        global_T_ego: (4, 4).
        grass: BGR, 0..255, after lighting.
        """
        image = np.empty((self._size[1], self._size[0], 3), dtype=np.uint8)
        cv2.rectangle(image, (0, self._sky_end), self._size, grass, cv2.FILLED)
        if self._sky_end:
            heading_deg = np.degrees(np.arctan2(global_T_ego[1, 0], global_T_ego[0, 0]))
            columns = self._panorama_columns + np.float32(heading_deg * PANORAMA_PX_PER_DEG)
            image[: self._sky_end] = cv2.remap(
                panorama, columns, self._panorama_rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP
            )
        return image

    def ground_brightness(self, grain: Image, global_T_ego: Array) -> Image:
        """The brightness of the ground: uint8, the image rows from the horizon down. 128 leaves a colour unchanged.

        grain: from `ground_grain`. Its contrast decreases with distance.
        global_T_ego: (4, 4).
        """
        rows = cv2.warpPerspective(
            grain,
            np.linalg.inv(self._rows_T_grain(global_T_ego)),
            self._transmittance.shape[::-1],
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_WRAP,
        )
        faded = cv2.multiply(rows, self._grain_contrast, scale=1 / 255)
        return np.asarray(cv2.add(faded, self._grain_base), dtype=np.uint8)

    def render_ground(
        self,
        image: Image,
        outlines: tuple[Array, Counts],
        colours: Sequence[tuple[float, ...]],
        brightness: Image,
    ) -> None:
        """Render areas of the ground, then shadows, then haze, into an image.

        image: changed in place.
        outlines: points (V, 3) [m] in the ego frame and counts (F,) of polygons: areas, then shadows. Later polygons
            cover earlier ones.
        colours: of the areas.
        brightness: from `ground_brightness`; changed in place.
        """
        horizon = np.array([0, self._first_row << SHIFT_BITS], dtype=np.int32)
        for outline, source in zip(*self._outlines(*outlines), strict=True):
            if source < len(colours):
                cv2.fillPoly(image, [outline], colours[source], cv2.LINE_AA, SHIFT_BITS)
            else:
                cv2.fillConvexPoly(brightness, outline - horizon, SHADOW, cv2.LINE_AA, SHIFT_BITS)
        gain = cv2.merge([cv2.multiply(brightness, self._transmittance, scale=1 / 255)] * 3)
        rows = image[self._first_row :]
        rows[:] = cv2.add(cv2.multiply(rows, gain, scale=1 / 128), self._haze)

    def render_objects(
        self, image: Image, polygons: Polygons, boxes: Array, occlusion_order: OcclusionOrder
    ) -> RenderedImage:
        """Render objects from far to near, and count the pixels of each.

        image: changed in place.
        polygons: of all objects, in the ego frame, with their final colours.
        boxes: (D, 9) in the ego frame.
        occlusion_order: of these boxes.
        """
        ids = np.zeros(image.shape[:2], dtype=np.uint16)
        num_unoccluded = np.zeros(len(boxes), dtype=np.int64)
        in_view = self._is_in_view(boxes)
        polygons = polygons.select(in_view[polygons.owners] & self._is_large_enough(polygons))
        ranks = self._ranks(in_view, occlusion_order)[polygons.owners]
        part_distances = np.linalg.norm(polygons.part_centres - self._eye, axis=1)
        outlines, sources = self._outlines(polygons.points, polygons.counts)
        order = np.lexsort((-part_distances[sources], ranks[sources]))
        outlines, sources = [outlines[i] for i in order.tolist()], sources[order]
        owners, solid = polygons.owners[sources], polygons.solid[sources].tolist()
        colours = polygons.colours[sources].tolist()
        # Each run is one object. When its polygons have just been rendered, no nearer object covers them yet, so
        # counting its ids gives its unoccluded pixels.
        runs = np.flatnonzero(np.diff(owners, prepend=-1)).tolist()
        regions = self._regions(boxes[owners[runs]])
        for first, end, region in zip(runs, [*runs, len(order)][1:], regions, strict=True):
            box_id = int(owners[first]) + 1
            for face in range(first, end):
                cv2.fillConvexPoly(image, outlines[face], colours[face], cv2.LINE_AA, SHIFT_BITS)
                if solid[face]:
                    cv2.fillConvexPoly(ids, outlines[face], box_id, cv2.LINE_8, SHIFT_BITS)
            num_unoccluded[box_id - 1] = np.count_nonzero(ids[region] == box_id)
        return RenderedImage(image, ids, num_unoccluded)

    def _rays(self) -> Array:
        """Directions (H, W, 3) of the pixel centres in the ego frame, not normalised."""
        u, v = np.meshgrid(np.arange(self._size[0]) + 0.5, np.arange(self._size[1]) + 0.5)
        pixels = np.stack([u, v, np.ones_like(u)], axis=-1)
        return pixels @ np.linalg.inv(self._camera.intrinsics_px).T @ self._camera.camera_T_ego[:3, :3]

    def _prepare_ground(self, rays: Array, light: Light) -> None:
        """Find the rows that show ground, and compute haze and contrast of the grain per pixel, as 8-bit factors."""
        is_ground = rays[..., 2] < 0
        # Rows from `_first_row` on show some ground, rows from `_sky_end` on show only ground.
        self._first_row = int(np.argmax(is_ground.any(axis=1)))
        self._sky_end = int(np.argmax(is_ground.all(axis=1)))
        downward = np.maximum(-rays[..., 2], 1e-9)
        distance_m = self._eye[2] / downward * np.linalg.norm(rays[..., :2], axis=-1)
        below = slice(self._first_row, None)
        transmittance = np.where(is_ground, np.exp(-distance_m / light.haze_distance_m), 1.0)[below]
        self._transmittance = (255 * transmittance).round().astype(np.uint8)
        self._haze = ((1 - transmittance)[..., None] * light.haze).round().astype(np.uint8)
        contrast = (255 * np.where(is_ground, np.exp(-distance_m / GRAIN_DEPTH_M), 0.0)[below]).round()
        self._grain_contrast = contrast.astype(np.uint8)
        self._grain_base = ((255 - contrast) * 128 / 255).astype(np.uint8)

    def _prepare_sky(self, rays: Array) -> None:
        """Compute where each sky pixel is in the panorama, for an ego with heading 0."""
        azimuth_deg = np.degrees(np.arctan2(rays[..., 1], rays[..., 0]))[: self._sky_end]
        self._panorama_columns = (azimuth_deg * PANORAMA_PX_PER_DEG).astype(np.float32)
        elevation_deg = np.degrees(np.arctan2(rays[..., 2], np.linalg.norm(rays[..., :2], axis=-1)))
        rows = (PANORAMA_TOP_DEG - elevation_deg[: self._sky_end]) * PANORAMA_PX_PER_DEG - 0.5
        self._panorama_rows = np.maximum(rows, 0).astype(np.float32)

    def _rows_T_grain(self, global_T_ego: Array) -> Array:
        """The homography (3, 3) from the grain tile to the image rows from the horizon down."""
        tile_m = GRAIN_TILE_PX / GRAIN_PX_PER_M
        corner_m = np.floor(global_T_ego[:2, 3] / tile_m) * tile_m
        global_T_grain = np.array(
            [[1 / GRAIN_PX_PER_M, 0, corner_m[0]], [0, 1 / GRAIN_PX_PER_M, corner_m[1]], [0, 0, 1]]
        )
        ego_T_global = inverse(global_T_ego)[np.ix_((0, 1, 3), (0, 1, 3))]
        rows_T_image = np.array([[1, 0, -0.5], [0, 1, -0.5 - self._first_row], [0, 0, 1]])
        return rows_T_image @ self._image_T_ego[:, [0, 1, 3]] @ ego_T_global @ global_T_grain

    def _outlines(self, points: Array, counts: Counts) -> tuple[list[Pixels], Counts]:
        """Project polygons, points (V, 3) in the ego frame and counts (F,), and clip them to the image.

        Returns F' outlines (k, 2) in OpenCV's fixed-point pixels, and the index of the polygon of each.
        """
        if not len(counts):
            return [], np.zeros(0, dtype=np.int64)
        clipped = clip_polygons(transform(self._camera.camera_T_ego, points), counts, self._planes)
        homogeneous = clipped.points @ self._camera.intrinsics_px.T
        pixels = homogeneous[:, :2] / np.maximum(homogeneous[:, 2:], NEAR_M) - 0.5
        fixed = np.rint(pixels * (1 << SHIFT_BITS)).astype(np.int32)
        starts, ends = clipped.starts.tolist(), (clipped.starts + clipped.counts).tolist()
        return [fixed[start:end] for start, end in zip(starts, ends, strict=True)], clipped.sources

    def _is_in_view(self, boxes: Array) -> NDArray[np.bool_]:
        """Whether the bounding sphere of each box reaches into the field of view, (D,)."""
        centres = np.column_stack([boxes[:, :3], np.ones(len(boxes))]) @ self._camera.camera_T_ego[:3].T
        planes = self._planes / np.linalg.norm(self._planes[:, :3], axis=1, keepdims=True)
        distances = centres @ planes[:, :3].T + planes[:, 3]
        return (distances > -np.linalg.norm(boxes[:, 3:6], axis=1)[:, None] / 2).all(axis=1)

    def _is_large_enough(self, polygons: Polygons) -> NDArray[np.bool_]:
        """Whether each polygon faces the camera and covers enough pixels to be rendered, (F,)."""
        areas_px2 = polygons.apparent_areas(self._eye) * self._camera.intrinsics_px[0, 0] ** 2
        return areas_px2 > np.where(polygons.solid, SMALLEST_SOLID_PX2, SMALLEST_DECAL_PX2)

    def _regions(self, boxes: Array) -> list[tuple[slice, slice]]:
        """The rows and columns that contain each box (D, 9), with a margin of two pixels."""
        pixels, depths = project(box_corners(boxes), self._image_T_ego)
        start, end = pixels.min(axis=1) - 2, pixels.max(axis=1) + 2
        is_cut = depths.min(axis=1) < NEAR_M
        start[is_cut], end[is_cut] = 0, self._size
        start, end = np.clip(start, 0, self._size).astype(int), np.clip(end, 0, self._size).astype(int)
        return [(slice(v0, v1), slice(u0, u1)) for (u0, v0), (u1, v1) in zip(start.tolist(), end.tolist(), strict=True)]

    def _ranks(self, in_view: NDArray[np.bool_], occlusion_order: OcclusionOrder) -> Counts:
        """The rank (D,) of each object in view, counted from far to near; 0 for the others."""
        ranks = np.zeros(len(in_view), dtype=np.int64)
        order = occlusion_order.far_to_near(np.flatnonzero(in_view), self._eye[:2])
        ranks[order] = np.arange(len(order))
        return ranks


def _clip_planes(camera: Camera) -> Array:
    """Planes (3, 4) of the camera frame, as in `clip_at_plane`: left, right and near."""
    focal, centre = camera.intrinsics_px[0, 0], camera.intrinsics_px[0, 2]
    margin = SIDE_MARGIN * camera.width_px
    return np.array(
        [
            [focal, 0, centre + margin, 0],
            [-focal, 0, camera.width_px + margin - centre, 0],
            [0, 0, 1, -NEAR_M],
        ]
    )
