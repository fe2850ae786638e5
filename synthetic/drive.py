"""`synthetic:SEED[:FRAMES]`: a rendered drive with exact ground truth, generated from a seed.

Each part of a drive has its own random stream, `np.random.default_rng([seed, number, ...])`. No two parts have the same
number.
"""

from collections.abc import Collection, Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..runtime.errors import InputError
from ..runtime.frame import Frame, GroundTruth
from ..runtime.geometry import inverse, rigid_transform, rotation_z
from .camera_renderer import RenderedImage
from .map_masks import RANGE_M, cells_touched, cells_with_centre_inside
from .nuscenes_rig import build_rig
from .renderer import Renderer
from .road import Road
from .snapshot import Snapshot
from .visibility import is_box_visible
from .world import VIEW_M, World

Array = NDArray[np.float64]

KEY_FRAME_INTERVAL_S = 0.5
TIME_JITTER_S = 0.004
DEFAULT_FRAMES = 16
MAX_FRAMES = 100_000
WORLD_VERSION = 2  # increased whenever the drive of a seed changes
FIRST_TRAINING_SEED = 10**18  # `synthetic:SEED` takes at most 18 digits, so it never gives a training drive
TOP_SPEED_M_S = 12.0
GRID = (200, 200)  # as in the paper
MAP_NAMES = ("drivable_area", "lane_boundary")


class KeyFrame(NamedTuple):
    """The content of one frame before rendering.

    global_T_ego: (4, 4).
    snapshot: all objects around the ego, in the ego frame.
    ground: kind and outline (k, 2) [m] in the ego frame of each area, in rendering order.
    lane_boundaries: outlines (k, 2) [m] in the ego frame.
    """

    global_T_ego: Array
    snapshot: Snapshot
    ground: list[tuple[str, Array]]
    lane_boundaries: list[Array]


class SyntheticDrive:
    """A drive of `frames` key frames at 2 Hz. Everything in it follows from the seed.

    The ground truth of a frame contains the objects of the ten classes that are visible, as defined by
    `is_box_visible`. Their centres are within 51.2 m of the ego in x and y. A map cell is drivable if its centre is on
    the road. It is a lane boundary if a lane boundary touches it.
    """

    def __init__(
        self,
        seed: int,
        frames: int = DEFAULT_FRAMES,
        image_size: tuple[int, int] = (400, 160),
        grid: tuple[int, int] = GRID,
    ) -> None:
        """frames: number of frames.
        image_size: width and height [px].
        grid: number of cells of the map masks in x and y.
        """
        self.seed = seed
        self._image_size = image_size
        self._scene = f"synthetic-{seed}"
        self.cameras = build_rig(seed, image_size)
        self._num_frames = frames
        self._grid = grid
        self._times_s = _key_frame_times(seed, frames)
        self._world = World(seed, Road(seed, TOP_SPEED_M_S * KEY_FRAME_INTERVAL_S * frames))
        self._renderer = Renderer(seed, self.cameras)

    def __reduce__(self) -> tuple[type["SyntheticDrive"], tuple[Any, ...]]:
        """A copy in another process is generated again: the world caches streets in functions, which have no copy."""
        return SyntheticDrive, (self.seed, self._num_frames, self._image_size, self._grid)

    @classmethod
    def parse(cls, spec: str, grid: tuple[int, int] = GRID) -> "SyntheticDrive":
        """Read `synthetic:SEED[:FRAMES]`. Raises InputError if `spec` has another form.

        grid: number of cells of the map masks in x and y.
        """
        scheme, *numbers = spec.split(":")
        if scheme != "synthetic" or len(numbers) not in (1, 2) or not all(map(_is_number, numbers)):
            raise InputError(
                f"expected synthetic:SEED[:FRAMES] with whole numbers, got {spec!r}; "
                "for example synthetic:7 or synthetic:7:32"
            )
        seed, frames = int(numbers[0]), int(numbers[1]) if len(numbers) == 2 else DEFAULT_FRAMES
        if not 1 <= frames <= MAX_FRAMES:
            raise InputError(
                f"expected 1 to {MAX_FRAMES} frames, got {frames} in {spec!r}; for example synthetic:{seed}:16"
            )
        return cls(seed, frames, grid=grid)

    @property
    def identity(self) -> str:
        """The specification of this drive, as `parse` reads it."""
        return f"synthetic:{self.seed}:{self._num_frames}"

    @property
    def tokens(self) -> Iterator[str]:
        """The token of each frame, in order."""
        return map(self._token, range(self._num_frames))

    def __len__(self) -> int:
        return self._num_frames

    def __iter__(self) -> Iterator[Frame]:
        return map(self.frame, range(self._num_frames))

    def frame(self, index: int) -> Frame:
        """Render frame `index`, counted from 0."""
        key_frame = self.key_frame(index)
        rendered = self.render(key_frame)
        return replace(
            self.frame_without_images(index),
            images={name: result.image for name, result in rendered.items()},
            ground_truth=self._ground_truth(key_frame, list(rendered.values())),
        )

    def frame_without_images(self, index: int) -> Frame:
        """Frame `index` without images and ground truth. Nothing is rendered."""
        global_T_ego, _ = self._ego_pose(index)
        return Frame(
            images=dict.fromkeys(self.cameras),
            cameras=self.cameras,
            global_T_ego=global_T_ego,
            timestamp_s=float(self._times_s[index]),
            scene=self._scene,
            token=self._token(index),
        )

    def scene_name(self, index: int) -> str:
        """The scene of frame `index`, the same for all frames."""
        return self._scene

    def check_image_files(self, index: int) -> tuple[str, ...]:
        """Return the names of the lost cameras of frame `index`: none. A synthetic drive has no image files."""
        return ()

    def has_boxes(self, index: int) -> bool:
        """Whether the ground-truth boxes of frame `index` are known; always true for a synthetic drive."""
        return True

    def has_maps(self, index: int) -> bool:
        """Whether the ground-truth maps of frame `index` are known; always true for a synthetic drive."""
        return True

    def map_names(self, index: int) -> frozenset[str]:
        """The names of the ground-truth maps of frame `index`, the same for all frames."""
        return frozenset(MAP_NAMES)

    def ground_truth_without_maps(self, index: int) -> GroundTruth:
        """The ground truth of frame `index` without maps. The ground is not rendered, since it hides no object."""
        key_frame = self.key_frame(index)._replace(ground=[])
        return _visible_objects(key_frame.snapshot, list(self.render(key_frame).values()))

    def check_class_names(self, classes: Collection[str]) -> None:
        """Does nothing: a synthetic drive only has the ten classes of nuScenes, which are known names."""

    def key_frame(self, index: int) -> KeyFrame:
        """The content of frame `index` before rendering."""
        time_s = self._time_since_start_s(index)
        global_T_ego, heading = self._ego_pose(index)
        ego_T_global = inverse(global_T_ego)
        start, end = self._world.ego_rate_m_s * time_s + np.array([-VIEW_M, VIEW_M])
        patches = list(self._world.road.ground_patches(start, end))
        outlines = outlines_to_ego(ego_T_global, [patch.outline for patch in patches])
        return KeyFrame(
            global_T_ego,
            self._world.snapshot(time_s).to_ego(ego_T_global, heading),
            [(patch.kind, outline) for patch, outline in zip(patches, outlines, strict=True)],
            outlines_to_ego(ego_T_global, list(self._world.road.lane_boundaries(start, end))),
        )

    def render(self, key_frame: KeyFrame) -> dict[str, RenderedImage]:
        """Render a key frame into every camera."""
        snapshot = key_frame.snapshot
        return self._renderer.render(key_frame.global_T_ego, key_frame.ground, snapshot.boxes, snapshot.meshes)

    def _token(self, index: int) -> str:
        return f"{self._scene}-{index:06d}"

    def _time_since_start_s(self, index: int) -> float:
        return float(self._times_s[index] - self._times_s[0])

    def _ego_pose(self, index: int) -> tuple[Array, float]:
        """global_T_ego (4, 4) of frame `index`, and its heading [rad]."""
        position, heading = self._world.ego_pose(self._time_since_start_s(index))
        return rigid_transform(rotation_z(heading), [*position, 0.0]), heading

    def _ground_truth(self, key_frame: KeyFrame, rendered: list[RenderedImage]) -> GroundTruth:
        road = [outline for kind, outline in key_frame.ground if kind == "asphalt"]
        masks = cells_with_centre_inside(road, self._grid), cells_touched(key_frame.lane_boundaries, self._grid)
        maps = dict(zip(MAP_NAMES, masks, strict=True))
        return replace(_visible_objects(key_frame.snapshot, rendered), maps=maps)


def _visible_objects(snapshot: Snapshot, rendered: list[RenderedImage]) -> GroundTruth:
    """The ground truth of a rendered key frame, without maps."""
    is_ground_truth = _is_ground_truth(snapshot, rendered)
    names = tuple(snapshot.names[i] for i in np.flatnonzero(is_ground_truth))
    return GroundTruth(snapshot.boxes[is_ground_truth], names)


def _is_ground_truth(snapshot: Snapshot, rendered: list[RenderedImage]) -> NDArray[np.bool_]:
    """Whether the ground truth contains each object, (D,)."""
    is_in_range = (np.abs(snapshot.boxes[:, :2]) <= RANGE_M).all(axis=1)
    return snapshot.is_labelled() & is_box_visible(rendered) & is_in_range


def _key_frame_times(seed: int, frames: int) -> Array:
    """Unix times (frames,) [s] at 2 Hz, each with a jitter of a few milliseconds."""
    rng = np.random.default_rng([seed, 8])
    start = 1.53e9 + rng.uniform(0, 1e7)
    return start + KEY_FRAME_INTERVAL_S * np.arange(frames) + rng.uniform(-TIME_JITTER_S, TIME_JITTER_S, frames)


def outlines_to_ego(ego_T_global: Array, outlines: list[Array]) -> list[Array]:
    """Outlines (k, 2) of the global frame in the ego frame."""
    points = np.concatenate(outlines) @ ego_T_global[:2, :2].T + ego_T_global[:2, 3]
    ends = np.cumsum([len(outline) for outline in outlines]).tolist()
    return [points[start:end] for start, end in zip([0, *ends], ends, strict=False)]


def _is_number(word: str) -> bool:
    return word.isascii() and word.isdigit() and len(word) < len(str(FIRST_TRAINING_SEED))
