"""One scene of the root: the ego vehicle at the time of each sensor, the images and the annotated objects."""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...data.class_names import BICYCLE_RACK
from ...runtime.geometry import inverse, rigid_transform, rotation_z
from ..camera_renderer import RenderedImage
from ..drive import outlines_to_ego
from ..nuscenes_rig import build_rig
from ..renderer import Renderer
from ..road import SEED_OFFSET
from ..snapshot import Snapshot
from ..world import VIEW_M, World
from .annotated_object import AnnotatedObject
from .bicycle_racks import BicycleRack, racks_between, with_bicycles
from .map_layout import Place
from .object_categories import choose_category
from .point_counts import count_lidar_points, count_radar_points
from .sensor_times import SensorTimes

Array = NDArray[np.float64]


class SceneFrame(NamedTuple):
    """The content of one key frame.

    rendered: the image of each camera by name.
    identities: of all objects in the images, scenery included, in the order of the ids in `rendered`.
    objects: everything that may be annotated, within `VIEW_M` of the ego.
    """

    rendered: Mapping[str, RenderedImage]
    identities: Sequence[tuple[int, ...]]
    objects: Sequence[AnnotatedObject]


class RootScene:
    """A drive through the synthetic world. Everything in it follows from the seed.

    Each camera has its own time stamp, and its image shows what it sees from the ego pose at that time. All other
    objects are shown where they are at the time of the key frame. So an annotated box, projected through the tables,
    is exactly on its object in the image; in real data, moving objects are off by their motion between the two times.
    """

    def __init__(self, seed: int, num_frames: int, image_size: tuple[int, int], place: Place) -> None:
        """image_size: width and height [px].
        place: of the scene in the root.
        """
        self.seed = seed
        self.times = SensorTimes(seed, num_frames)
        self.cameras = build_rig(seed, image_size)
        self._place = place
        self._world = World(seed, place.road)

    def __len__(self) -> int:
        return len(self.times.key_frames_us)

    def frames(self) -> Iterator[SceneFrame]:
        """Render the key frames, one after the other."""
        renderer = Renderer(self.seed, self.cameras)
        return (self._frame(renderer, index) for index in range(len(self)))

    def global_T_ego(self, timestamp_us: int) -> Array:
        """The ego pose (4, 4) in the global frame of the root."""
        world_T_ego, _ = self._world_T_ego(timestamp_us)
        return rigid_transform(world_T_ego[:3, :3], world_T_ego[:3, 3] + [*self._place.origin_m, 0.0])

    def _frame(self, renderer: Renderer, index: int) -> SceneFrame:
        """Render key frame `index` into all cameras, each at its own ego pose."""
        time_us = self.times.key_frames_us[index]
        along = self._along_m(time_us)
        racks = list(racks_between(self.seed, self._place.road, along - VIEW_M, along + VIEW_M))
        snapshot = with_bicycles(self._world.snapshot(self.times.since_start_s(time_us)), racks)
        rendered: dict[str, RenderedImage] = {}
        for name, camera_us in self.times.of_cameras(index).items():
            world_T_ego, heading = self._world_T_ego(camera_us)
            view = snapshot.to_ego(inverse(world_T_ego), heading)
            ground = self._ground(along, world_T_ego)
            rendered |= renderer.render(world_T_ego, ground, view.boxes, view.meshes, [name])
        objects = self._annotated_objects(index, snapshot, racks, list(rendered.values()))
        return SceneFrame(rendered, snapshot.identities, list(objects))

    def _ground(self, along_m: float, world_T_ego: Array) -> list[tuple[str, Array]]:
        """Kind and outline (k, 2) [m] in the ego frame of each area of the ground around an arc length."""
        patches = list(self._place.road.ground_patches(along_m - VIEW_M, along_m + VIEW_M))
        outlines = outlines_to_ego(inverse(world_T_ego), [patch.outline for patch in patches])
        return [(patch.kind, outline) for patch, outline in zip(patches, outlines, strict=True)]

    def _annotated_objects(
        self, index: int, snapshot: Snapshot, racks: Sequence[BicycleRack], rendered: Sequence[RenderedImage]
    ) -> Iterator[AnnotatedObject]:
        """The labelled objects of a key frame, then the racks."""
        position = self._world.ego_pose(self.times.since_start_s(self.times.key_frames_us[index]))[0]
        shares = _visible_shares(rendered)
        for row in np.flatnonzero(snapshot.is_labelled()).tolist():
            identity, box = snapshot.identities[row], snapshot.boxes[row]
            category = choose_category(snapshot.names[row], self._random_stream(10, identity))
            yield self._annotated_object(index, identity, category, box, float(shares[row]), position)
        for rack in racks:
            own = [row for row, identity in enumerate(snapshot.identities) if identity[:3] == rack.identity]
            yield self._annotated_object(
                index, rack.identity, BICYCLE_RACK, rack.box(), float(shares[own].max(initial=0.0)), position
            )

    def _annotated_object(
        self, index: int, identity: tuple[int, ...], category: str, box: Array, visible_share: float, ego_m: Array
    ) -> AnnotatedObject:
        rng = self._random_stream(11, (*identity, index))
        distance = float(np.hypot(*(box[:2] - ego_m)))
        lidar = count_lidar_points(box[3:6], distance, visible_share, rng)
        radar = count_radar_points(category, distance, visible_share, rng)
        in_root = box.copy()
        in_root[:2] += self._place.origin_m
        return AnnotatedObject(identity, category, in_root, visible_share, lidar, radar)

    def _random_stream(self, number: int, identity: tuple[int, ...]) -> np.random.Generator:
        return np.random.default_rng([self.seed, number, *(part + SEED_OFFSET for part in identity)])

    def _along_m(self, timestamp_us: int) -> float:
        return self._world.ego_rate_m_s * self.times.since_start_s(timestamp_us)

    def _world_T_ego(self, timestamp_us: int) -> tuple[Array, float]:
        """The ego pose (4, 4) in the frame of the world, and its heading [rad]."""
        position, heading = self._world.ego_pose(self.times.since_start_s(timestamp_us))
        return rigid_transform(rotation_z(heading), [*position, 0.0]), heading


def _visible_shares(rendered: Sequence[RenderedImage]) -> Array:
    """The share (D,) of the pixels of each box that are visible, over all images; 0 for boxes without pixels."""
    num_boxes = len(rendered[0].num_unoccluded)
    visible = sum(np.bincount(image.ids.ravel(), minlength=num_boxes + 1)[1:] for image in rendered)
    unoccluded = sum(image.num_unoccluded for image in rendered)
    return np.asarray(visible / np.maximum(unoccluded, 1))
