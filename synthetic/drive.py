"""`synthetic:SEED[:FRAMES]`: a drawn drive through a small world, with exact truth; no download, no state."""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from ..runtime.errors import InputError
from ..runtime.frame import Camera, Frame, GroundTruth
from ..runtime.geometry import CAMERA_R_BODY, inverse, rigid, rotation_z, transform
from .renderer import Picture, Renderer
from .road import Road
from .world import VIEW_M, Scene, World

Array = NDArray[np.float64]

KEY_FRAME_INTERVAL_S = 0.5
TIME_JITTER_S = 0.004
MAX_FRAMES = 100_000
WORLD_VERSION = 2  # counts on whenever a seed comes to mean another drive
FIRST_TRAINING_SEED = 10**18  # `synthetic:SEED` takes 18 digits: what is trained on, it never shows
TOP_SPEED_MPS = 12.0
RANGE_M = 51.2
GRID = (200, 200)  # the paper's
LEAST_VISIBLE_PX = 4
LEAST_VISIBLE_SHARE = 0.15
MAP_SUBSAMPLING = 5  # odd, so that a cell's centre is a fine pixel's centre


class Mount(NamedTuple):
    """How a nuScenes camera is mounted, and its lens for an image 1600 pixels wide."""

    position_m: tuple[float, float, float]
    yaw_deg: float
    focal_px: float


MOUNTS = {
    "CAM_FRONT": Mount((1.70, 0.02, 1.51), 0.0, 1266.0),
    "CAM_FRONT_RIGHT": Mount((1.55, -0.49, 1.50), -55.0, 1266.0),
    "CAM_FRONT_LEFT": Mount((1.52, 0.49, 1.51), 55.0, 1266.0),
    "CAM_BACK": Mount((0.03, 0.00, 1.57), 180.0, 809.0),
    "CAM_BACK_LEFT": Mount((1.04, 0.48, 1.59), 110.0, 1266.0),
    "CAM_BACK_RIGHT": Mount((1.02, -0.48, 1.56), -110.0, 1266.0),
}


class KeyFrame(NamedTuple):
    """One frame's scene, before it is drawn. scene: in the ego frame; ground: outlines (k, 2) by kind."""

    global_T_ego: Array
    scene: Scene
    ground: list[tuple[str, Array]]
    boundaries: list[Array]


class SyntheticDrive:
    """A drive of `frames` key frames at 2 Hz, all of it from the seed.

    A box is in the truth if its centre lies within 51.2 m of the ego in x and in y and if some camera sees it:
    in that camera's picture at least 4 pixels of it, and at least 15 % of those that it would show there if
    nothing stood before it. A cell is drivable where its centre is; it holds a lane boundary where one touches it.
    """

    def __init__(
        self,
        seed: int,
        frames: int = 16,
        image_size: tuple[int, int] = (400, 160),
        grid: tuple[int, int] = GRID,
    ) -> None:
        """image_size: width and height [px]; grid: cells of the map masks along x and y."""
        self.seed = seed
        self.scene_name = f"synthetic-{seed}"
        self.cameras = build_rig(seed, image_size)
        self._num_frames = frames
        self._grid = grid
        self._times_s = _key_frame_times(seed, frames)
        self._world = World(seed, Road(seed, TOP_SPEED_MPS * KEY_FRAME_INTERVAL_S * frames))
        self._painter = Renderer(seed, self.cameras)

    @classmethod
    def parse(cls, spec: str, grid: tuple[int, int] = GRID) -> "SyntheticDrive":
        """Read `synthetic:SEED[:FRAMES]`; grid: cells of the map masks. Raises InputError when it is something else."""
        scheme, *numbers = spec.split(":")
        if scheme != "synthetic" or len(numbers) not in (1, 2) or not all(map(_is_number, numbers)):
            raise InputError(
                f"expected synthetic:SEED[:FRAMES] with whole numbers, got {spec!r}; "
                "for example synthetic:7 or synthetic:7:32"
            )
        seed, frames = int(numbers[0]), int(numbers[1]) if len(numbers) == 2 else 16
        if not 1 <= frames <= MAX_FRAMES:
            raise InputError(
                f"expected 1 to {MAX_FRAMES} frames, got {frames} in {spec!r}; for example synthetic:{seed}:16"
            )
        return cls(seed, frames, grid=grid)

    @property
    def identity(self) -> str:
        return f"synthetic:{self.seed}:{self._num_frames}"

    @property
    def tokens(self) -> Iterator[str]:
        return map(self._token, range(self._num_frames))

    def __len__(self) -> int:
        return self._num_frames

    def __iter__(self) -> Iterator[Frame]:
        return map(self.frame, range(self._num_frames))

    def frame(self, index: int) -> Frame:
        """Draw frame `index`, counted from 0."""
        moment = self.moment(index)
        pictures = self.paint(moment)
        return replace(
            self.frame_without_images(index),
            images={name: picture.image for name, picture in pictures.items()},
            ground_truth=self._truth(moment, list(pictures.values())),
        )

    def frame_without_images(self, index: int) -> Frame:
        """Frame `index` without its images and truth; nothing is drawn."""
        global_T_ego, _ = self._ego(index)
        return Frame(
            images=dict.fromkeys(self.cameras),
            cameras=self.cameras,
            global_T_ego=global_T_ego,
            timestamp_s=float(self._times_s[index]),
            scene=self.scene_name,
            token=self._token(index),
        )

    def has_boxes(self, index: int) -> bool:
        """They always are."""
        return True

    def ground_truth_boxes(self, index: int) -> Array:
        """The true boxes (D, 9) of frame `index`, as in its truth. The ground hides none, and is not drawn."""
        moment = self.moment(index)._replace(ground=[])
        return moment.scene.boxes[_is_known(moment.scene, list(self.paint(moment).values()))]

    def _token(self, index: int) -> str:
        return f"{self.scene_name}-{index:06d}"

    def moment(self, index: int) -> KeyFrame:
        """What stands where at frame `index`."""
        time_s = self._since_start_s(index)
        global_T_ego, heading = self._ego(index)
        ego_T_global = inverse(global_T_ego)
        start, end = self._world.ego_rate_mps * time_s + np.array([-VIEW_M, VIEW_M])
        patches = list(self._world.road.patches(start, end))
        outlines = _to_ego_ground(ego_T_global, [patch.outline for patch in patches])
        return KeyFrame(
            global_T_ego,
            _to_ego(ego_T_global, heading, self._world.scene(time_s)),
            [(patch.kind, outline) for patch, outline in zip(patches, outlines, strict=True)],
            _to_ego_ground(ego_T_global, list(self._world.road.boundaries(start, end))),
        )

    def _since_start_s(self, index: int) -> float:
        return float(self._times_s[index] - self._times_s[0])

    def _ego(self, index: int) -> tuple[Array, float]:
        """global_T_ego at frame `index`, and the heading in it [rad]."""
        position, heading = self._world.ego_pose(self._since_start_s(index))
        return rigid(rotation_z(heading), [*position, 0.0]), heading

    def paint(self, moment: KeyFrame) -> dict[str, Picture]:
        """Draw a moment into every camera."""
        scene = moment.scene
        return self._painter.paint(moment.global_T_ego, moment.ground, scene.boxes, scene.meshes)

    def _truth(self, moment: KeyFrame, pictures: list[Picture]) -> GroundTruth:
        boxes = moment.scene.boxes
        is_known = _is_known(moment.scene, pictures)
        road = [outline for kind, outline in moment.ground if kind == "asphalt"]
        return GroundTruth(
            boxes[is_known],
            tuple(moment.scene.names[i] for i in np.flatnonzero(is_known)),
            {
                "drivable_area": centres_within(road, self._grid),
                "lane_boundary": cells_touched(moment.boundaries, self._grid),
            },
        )


def build_rig(seed: int, image_size: tuple[int, int]) -> dict[str, Camera]:
    """The nuScenes rig, off by up to two degrees and a decimetre: 1600x900 scaled to the width, cut at the top."""
    rng = np.random.default_rng([seed, 7])
    width, height = image_size
    scale = width / 1600
    cameras = {}
    for name, mount in MOUNTS.items():
        focal = mount.focal_px * scale * rng.uniform(0.985, 1.015)
        centre = (800 * scale, 491 * scale - (900 * scale - height)) + rng.uniform(-10, 10, 2) * scale
        intrinsics = np.array([[focal, 0, centre[0]], [0, focal, centre[1]], [0, 0, 1]])
        yaw, pitch, roll = np.radians((mount.yaw_deg, 0, 0) + rng.uniform(-1, 1, 3) * (2.0, 1.0, 1.0))
        position = mount.position_m + rng.uniform(-0.1, 0.1, 3)
        ego_R_camera = rotation_z(yaw) @ _tilt(pitch, roll) @ CAMERA_R_BODY.T
        cameras[name] = Camera(intrinsics, inverse(rigid(ego_R_camera, position)), width, height)
    return cameras


def is_visible(pictures: list[Picture]) -> NDArray[np.bool_]:
    """(D,) whether some picture shows enough of a box; the rule is SyntheticDrive's."""
    num_boxes = len(pictures[0].num_covered)
    num_seen = np.array([np.bincount(p.ids.ravel(), minlength=num_boxes + 1)[1:] for p in pictures])
    num_covered = np.array([picture.num_covered for picture in pictures])
    shows = (num_seen >= LEAST_VISIBLE_PX) & (num_seen >= LEAST_VISIBLE_SHARE * num_covered)
    return np.logical_or.reduce(shows)


def _is_known(scene: Scene, pictures: list[Picture]) -> NDArray[np.bool_]:
    """(D,) whether a box is in the truth."""
    return scene.is_actor() & is_visible(pictures) & (np.abs(scene.boxes[:, :2]) <= RANGE_M).all(axis=1)


def centres_within(outlines: list[Array], grid: tuple[int, int]) -> NDArray[np.bool_]:
    """The cells (X, Y) of the range whose centre lies in one of the outlines (k, 2) of the ego frame."""
    middle = MAP_SUBSAMPLING // 2
    return _rasterize(outlines, grid)[:, middle, :, middle]


def cells_touched(outlines: list[Array], grid: tuple[int, int]) -> NDArray[np.bool_]:
    """The cells (X, Y) of the range of which an outline (k, 2) covers a part: thin lines stay whole."""
    return np.logical_or.reduce(_rasterize(outlines, grid), axis=(1, 3))


def _rasterize(outlines: list[Array], grid: tuple[int, int]) -> NDArray[np.bool_]:
    """Which of the parts (X, S, Y, S) of the cells have their centre in an outline."""
    fine = np.zeros((grid[0] * MAP_SUBSAMPLING, grid[1] * MAP_SUBSAMPLING), dtype=np.uint8)
    for outline in outlines:
        # An OpenCV point is (column, row): (y, x) here.
        cells = (outline[:, ::-1] + RANGE_M) / (2 * RANGE_M) * fine.shape[::-1] - 0.5
        cv2.fillPoly(fine, [np.rint(cells * 16).astype(np.int32)], 1, cv2.LINE_8, 4)
    return fine.reshape(grid[0], MAP_SUBSAMPLING, grid[1], MAP_SUBSAMPLING).astype(bool)


def _key_frame_times(seed: int, frames: int) -> Array:
    """Unix times (frames,) at 2 Hz, each off by a few milliseconds."""
    rng = np.random.default_rng([seed, 8])
    start = 1.53e9 + rng.uniform(0, 1e7)
    return start + KEY_FRAME_INTERVAL_S * np.arange(frames) + rng.uniform(-TIME_JITTER_S, TIME_JITTER_S, frames)


def _to_ego(ego_T_global: Array, heading_rad: float, scene: Scene) -> Scene:
    boxes = scene.boxes.copy()
    boxes[:, :3] = transform(ego_T_global, boxes[:, :3])
    boxes[:, 6] = np.pi - (np.pi - (boxes[:, 6] - heading_rad)) % (2 * np.pi)
    boxes[:, 7:9] = boxes[:, 7:9] @ ego_T_global[:2, :2].T
    return Scene(boxes, scene.names, scene.meshes, scene.identities)


def _to_ego_ground(ego_T_global: Array, outlines: list[Array]) -> list[Array]:
    points = np.concatenate(outlines) @ ego_T_global[:2, :2].T + ego_T_global[:2, 3]
    ends = np.cumsum([len(outline) for outline in outlines]).tolist()
    return [points[start:end] for start, end in zip([0, *ends], ends, strict=False)]


def _tilt(pitch_rad: float, roll_rad: float) -> Array:
    """A rotation (3, 3) about y (nose down), after one about x."""
    cp, sp, cr, sr = np.cos(pitch_rad), np.sin(pitch_rad), np.cos(roll_rad), np.sin(roll_rad)
    return np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]]) @ np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])


def _is_number(word: str) -> bool:
    return word.isascii() and word.isdigit() and len(word) < len(str(FIRST_TRAINING_SEED))
