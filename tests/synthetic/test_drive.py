import time
from functools import cache

import numpy as np
import pytest

from duospacenet.jobs.sources import open_source
from duospacenet.runtime.errors import InputError
from duospacenet.runtime.geometry import box_corners, image_T_ego, project, rigid, rotation_z, transform
from duospacenet.synthetic.drive import SyntheticDrive, build_rig, centres_within, is_visible
from duospacenet.synthetic.renderer import Renderer
from duospacenet.synthetic.object_meshes import build_mesh
from duospacenet.synthetic.world import CLASS_SIZES_M, Scene

CLASS_ORDER = (
    "car", "truck", "construction_vehicle", "bus", "trailer", "barrier", "motorcycle", "bicycle", "pedestrian",
    "traffic_cone",
)  # fmt: skip
BOXY = ("truck", "bus", "trailer", "barrier", "car")
ASPHALT = [("asphalt", np.array([[-90.0, -90.0], [90.0, -90.0], [90.0, 90.0], [-90.0, 90.0]]))]


@pytest.fixture(scope="module")
def drive() -> SyntheticDrive:
    return SyntheticDrive(7, frames=6)


def box_at(name: str, x: float, y: float, yaw: float = 0.0) -> np.ndarray:
    w, l, h = CLASS_SIZES_M[name]  # noqa: E741
    return np.array([x, y, h / 2, w, l, h, yaw, 0.0, 0.0])


@cache
def painter_of(size: tuple[int, int]) -> tuple[Renderer, dict]:
    cameras = build_rig(3, size)
    return Renderer(3, cameras), cameras


def paint(size, names, boxes):
    painter, cameras = painter_of(size)
    sizes = [tuple(box[3:6]) for box in boxes]
    meshes = [build_mesh(name, size, np.random.default_rng(0)) for name, size in zip(names, sizes, strict=True)]
    return painter.paint(np.eye(4), ASPHALT, np.array(boxes), meshes), cameras


def global_boxes(moment) -> Scene:
    """The moment's actors in the global frame, worked out from the pose alone."""
    scene, pose = moment.scene, moment.global_T_ego
    boxes = scene.boxes.copy()
    boxes[:, :3] = transform(pose, boxes[:, :3])
    boxes[:, 7:9] = boxes[:, 7:9] @ pose[:2, :2].T
    return Scene(boxes, scene.names, scene.meshes, scene.identities)


def tracks_over(drive: SyntheticDrive) -> dict:
    """By identity: frame index -> global box, of everything of the ten classes."""
    tracks: dict = {}
    for index in range(len(drive)):
        scene = global_boxes(drive.moment(index))
        for i in np.flatnonzero(scene.is_actor()):
            tracks.setdefault(scene.identities[i], {})[index] = scene.boxes[i]
    return tracks


def test_the_same_seed_gives_the_same_frames_bit_for_bit():
    drive, again = SyntheticDrive(5, frames=3), SyntheticDrive(5, frames=3)
    for a, b in [*zip(drive, again, strict=True), *zip(drive, drive, strict=True)]:
        assert (a.timestamp_s, a.scene, a.token) == (b.timestamp_s, b.scene, b.token)
        assert np.array_equal(a.global_T_ego, b.global_T_ego)
        assert np.array_equal(a.ground_truth.boxes, b.ground_truth.boxes)
        assert a.ground_truth.classes == b.ground_truth.classes
        for name in a.images:
            assert np.array_equal(a.images[name], b.images[name])
        for name in a.ground_truth.maps:
            assert np.array_equal(a.ground_truth.maps[name], b.ground_truth.maps[name])


def test_a_frame_is_the_same_wherever_a_drive_is_entered():
    last = list(SyntheticDrive(5, frames=4))[3]
    entered = SyntheticDrive(5, frames=4).frame(3)
    assert np.array_equal(last.ground_truth.boxes, entered.ground_truth.boxes)
    assert all(np.array_equal(last.images[name], entered.images[name]) for name in last.images)


def test_different_seeds_give_different_drives():
    a, b = next(iter(SyntheticDrive(1, frames=1))), next(iter(SyntheticDrive(2, frames=1)))
    assert a.timestamp_s != b.timestamp_s
    assert not np.allclose(a.global_T_ego, b.global_T_ego)
    assert all((a.images[name] != b.images[name]).mean() > 0.5 for name in a.images)
    assert not np.array_equal(a.cameras["CAM_BACK"].intrinsics_px, b.cameras["CAM_BACK"].intrinsics_px)


def test_frames_come_at_two_hertz_from_a_car_that_moves_like_one(drive):
    frames = [drive.frame_without_images(index) for index in range(len(drive))]
    gaps_s = np.diff([frame.timestamp_s for frame in frames])
    assert np.all(np.abs(gaps_s - 0.5) < 0.01)
    assert len(set(gaps_s)) > 1
    assert frames[0].timestamp_s > 1e9
    positions = np.array([frame.global_T_ego[:3, 3] for frame in frames])
    assert np.linalg.norm(positions[0]) > 200
    speeds = np.linalg.norm(np.diff(positions, axis=0), axis=1) / gaps_s
    assert np.all((speeds > 4.5) & (speeds < 13.0))
    heading = np.array([frame.global_T_ego[:2, 0] for frame in frames])
    along = np.diff(positions, axis=0)[:, :2] / np.linalg.norm(np.diff(positions, axis=0), axis=1)[:, None]
    assert np.all((along * (heading[1:] + heading[:-1]) / 2).sum(axis=1) > 0.999)


def test_a_frame_says_which_scene_and_which_frame_it_is(drive):
    assert drive.frame(3).scene == "synthetic-7"
    assert drive.frame(3).token == "synthetic-7-000003"


@pytest.mark.parametrize("seed", range(4))
def test_true_velocities_are_the_change_of_true_positions(seed):
    drive = SyntheticDrive(seed, frames=5)
    times_s = [drive.frame_without_images(index).timestamp_s for index in range(5)]
    num_moving = 0
    for track in tracks_over(drive).values():
        for index in range(1, 4):
            if {index - 1, index, index + 1} <= track.keys():
                moved = track[index + 1][:2] - track[index - 1][:2]
                measured = moved / (times_s[index + 1] - times_s[index - 1])
                assert np.allclose(track[index][7:9], measured, atol=0.03)
                num_moving += np.linalg.norm(measured) > 0.5
    assert num_moving > 20


def test_moving_vehicles_move_the_way_they_face(drive):
    scene = drive.moment(2).scene
    speed = np.linalg.norm(scene.boxes[:, 7:9], axis=1)
    moving = speed > 0.5
    facing = np.stack([np.cos(scene.boxes[:, 6]), np.sin(scene.boxes[:, 6])], axis=1)
    assert moving.sum() > 5
    assert np.allclose(scene.boxes[moving, 7:9], facing[moving] * speed[moving, None], atol=1e-6)


def test_what_stands_keeps_its_place_in_the_global_frame(drive):
    standing = [t for t in tracks_over(drive).values() if np.allclose(next(iter(t.values()))[7:9], 0) and len(t) > 2]
    assert len(standing) > 10
    for track in standing:
        places = np.array([box[:6] for box in track.values()])
        assert np.ptp(places, axis=0).max() < 1e-6


def test_truth_is_what_stands_there_within_range(drive):
    for index, frame in enumerate(drive):
        boxes, known = frame.ground_truth.boxes, drive.moment(index).scene
        assert boxes.dtype == np.float64
        assert boxes.shape == (len(frame.ground_truth.classes), 9)
        assert np.all(np.abs(boxes[:, :2]) <= 51.2)
        assert np.all((boxes[:, 6] > -np.pi) & (boxes[:, 6] <= np.pi))
        assert np.allclose(boxes[:, 2], boxes[:, 5] / 2)
        rows = {(name, *box) for name, box in zip(known.names, known.boxes.tolist(), strict=True)}
        assert {(name, *box) for name, box in zip(frame.ground_truth.classes, boxes.tolist(), strict=True)} <= rows


@pytest.mark.parametrize("seed", range(6))
def test_every_class_occurs_in_a_drive_and_no_frame_is_empty(seed):
    seen: set[str] = set()
    for frame in SyntheticDrive(seed, image_size=(160, 64)):
        seen |= set(frame.ground_truth.classes)
        assert 8 <= len(frame.ground_truth.boxes) <= 60
    assert tuple(CLASS_SIZES_M) == CLASS_ORDER
    assert seen == set(CLASS_ORDER)


@pytest.mark.parametrize("seed", range(12))
def test_nothing_overlaps_anything_or_the_ego(seed):
    drive = SyntheticDrive(seed, frames=12)
    ego = np.array([[1.4, 0, 0.8, 1.75, 4.1, 1.6, 0, 0, 0]])
    for index in range(0, 12, 3):
        scene = drive.moment(index).scene
        near = scene.is_actor() & (np.abs(scene.boxes[:, :2]) < 60).all(axis=1)
        corners = box_corners(np.concatenate([ego, scene.boxes[near]]))[:, :4, :2]
        for i in range(len(corners)):
            for j in range(i):
                assert are_apart(corners[i], corners[j]), (seed, index, i, j)


def are_apart(a: np.ndarray, b: np.ndarray) -> bool:
    """Two rectangles (4, 2) lie apart along the direction of a side of one of them."""
    for side in (a[1] - a[0], a[2] - a[1], b[1] - b[0], b[2] - b[1]):
        if (a @ side).max() <= (b @ side).min() or (b @ side).max() <= (a @ side).min():
            return True
    return False


@pytest.mark.parametrize("name", CLASS_ORDER)
@pytest.mark.parametrize(
    ("camera_name", "x", "y"), [("CAM_FRONT", 18.0, 1.5), ("CAM_FRONT_LEFT", 12.0, 17.0), ("CAM_BACK", -14.0, -3.0)]
)
@pytest.mark.parametrize("yaw", [0.0, 0.7, 2.6])
def test_a_drawn_object_fills_its_projected_box(name, camera_name, x, y, yaw):
    box = box_at(name, x, y, yaw)
    pictures, cameras = paint((800, 320), [name], [box])
    pixels = corners_px(cameras[camera_name], box)
    expected = np.array([pixels.min(axis=0), pixels.max(axis=0)]).clip(0, (800, 320))
    rows, columns = np.nonzero(pictures[camera_name].ids == 1)
    drawn = np.array([[columns.min(), rows.min()], [columns.max() + 1, rows.max() + 1]])
    outside = np.maximum(expected[0] - drawn[0], drawn[1] - expected[1])
    assert np.all(outside <= 1.5)
    missing = np.maximum(drawn[0] - expected[0], expected[1] - drawn[1])
    extent = expected[1] - expected[0]
    assert np.all(missing <= 1.5 + (0.12 if name in BOXY else 0.25) * extent)


def corners_px(camera, box):
    return project(box_corners(box)[0], image_T_ego(camera.intrinsics_px, camera.camera_T_ego))[0]


@pytest.mark.parametrize("name", ["bus", "trailer"])
@pytest.mark.parametrize(("camera_name", "x", "y"), [("CAM_FRONT", 27.0, 1.0), ("CAM_BACK_RIGHT", -12.0, -22.0)])
def test_colours_change_exactly_where_a_tall_box_stands_before_the_sky(name, camera_name, x, y):
    bystander, box = box_at("traffic_cone", -x, -y), box_at(name, x, y, 0.5)
    pictures, cameras = paint((400, 160), ["traffic_cone"], [bystander])
    before = pictures[camera_name].image
    after = paint((400, 160), ["traffic_cone", name], [bystander, box])[0][camera_name].image
    horizon = int(cameras[camera_name].intrinsics_px[1, 2]) - 6  # shadows fall below it
    change = np.abs(after.astype(int) - before).max(axis=2)[:horizon]
    rows, columns = np.nonzero(change > np.median(change[change > 0]) / 2)
    pixels = corners_px(cameras[camera_name], box)
    assert abs(columns.min() - pixels[:, 0].min()) < 1.5
    assert abs(columns.max() + 1 - pixels[:, 0].max()) < 1.5
    assert abs(rows.min() - pixels[:, 1].min()) < 1.5


def test_objects_are_drawn_without_a_shift_of_half_a_pixel():
    errors = []
    for offset in np.linspace(-2.0, 2.0, 12):
        box = box_at("trailer", 30.0 + offset, offset, 0.0)
        pictures, cameras = paint((800, 320), ["trailer"], [box])
        rows, columns = np.nonzero(pictures["CAM_FRONT"].ids == 1)
        pixels = corners_px(cameras["CAM_FRONT"], box)
        drawn = np.array([columns.min() + columns.max() + 1, rows.min() + rows.max() + 1]) / 2
        errors.append(drawn - (pixels.min(axis=0) + pixels.max(axis=0)) / 2)
    assert np.all(np.abs(np.mean(errors, axis=0)) < 0.2)


def test_what_stands_behind_a_bus_is_not_visible():
    bus, hidden, beside = box_at("bus", 15.0, 0.0, np.pi / 2), box_at("car", 24.0, 0.0), box_at("car", 24.0, 14.0)
    pictures, _ = paint((400, 160), ["car", "bus", "car"], [hidden, bus, beside])
    assert is_visible(list(pictures.values())).tolist() == [False, True, True]


def test_a_walker_behind_a_long_bus_is_hidden_though_its_middle_is_nearer():
    bus, walker = box_at("bus", 16.0, -4.0), box_at("pedestrian", 13.5, -6.4)
    assert np.hypot(*walker[:2]) < np.hypot(*bus[:2])
    pictures, _ = paint((400, 160), ["bus", "pedestrian"], [bus, walker])
    assert is_visible([pictures["CAM_FRONT"]]).tolist() == [True, False]


def test_a_mask_cell_is_counted_forward_and_left():
    outline = np.array([[10.0, 5.0], [20.0, 5.0], [20.0, 8.0], [10.0, 8.0]])
    mask = centres_within([outline], (200, 200))
    for i in range(200):
        for j in range(200):
            x, y = -51.2 + (i + 0.5) * 0.512, -51.2 + (j + 0.5) * 0.512
            if min(abs(x - 10), abs(x - 20), abs(y - 5), abs(y - 8)) > 0.08:
                assert mask[i, j] == (10 < x < 20 and 5 < y < 8)


def test_the_road_reaches_farther_to_the_left_as_traffic_keeps_to_the_right(drive):
    for index in range(len(drive)):
        road = drive.frame(index).ground_truth.maps["drivable_area"]
        assert road.shape == (200, 200)
        assert road.dtype == bool
        beside = road[95:105]
        assert beside[:, 100:].sum() > beside[:, :100].sum() + 10


@pytest.mark.parametrize("seed", [0, 1, 2, 7])
def test_cells_of_the_road_look_like_asphalt_and_others_do_not(seed):
    drive = SyntheticDrive(seed, frames=2, image_size=(800, 320))
    moment, road = drive.moment(1), drive.frame(1).ground_truth.maps["drivable_area"]
    centre = -51.2 + (np.arange(200) + 0.5) * 0.512
    points = np.stack([*np.meshgrid(centre, centre, indexing="ij"), np.zeros((200, 200))], axis=-1)
    inner = road & np.roll(road, 1, 0) & np.roll(road, -1, 0) & np.roll(road, 1, 1) & np.roll(road, -1, 1)
    road_colours, other_colours = [], []
    for name, picture in drive.paint(moment).items():
        camera = drive.cameras[name]
        pixels, depth = project(points, image_T_ego(camera.intrinsics_px, camera.camera_T_ego))
        inside = ((pixels > 0) & (pixels < (800, 320))).all(axis=-1) & (depth > 1) & (depth < 22)
        u, v = np.where(inside[..., None], pixels, 0).astype(int).transpose(2, 0, 1)
        free = inside & (picture.ids[v, u] == 0)
        road_colours.append(picture.image[v, u][free & inner])
        other_colours.append(picture.image[v, u][free & ~road])
    on_road, off_road = np.concatenate(road_colours), np.concatenate(other_colours)
    road_is_green, other_is_green = greenness_of(on_road) > 1.15, greenness_of(off_road) > 1.15
    assert len(on_road) > 300
    assert road_is_green.mean() < 0.01
    assert other_is_green.mean() > 0.2
    assert np.median(off_road[~other_is_green]) > 1.15 * np.median(on_road)  # the sidewalk


def greenness_of(colours: np.ndarray) -> np.ndarray:
    """Green against the mean of blue and red; 0 for the yellow of the centre line."""
    blue, green, red = colours.astype(np.float64).T + 1
    return np.where(red > 1.15 * green, 0.0, green / ((blue + red) / 2))


def test_lane_boundaries_lie_on_the_road_and_are_thin(drive):
    for frame in drive:
        lines, road = frame.ground_truth.maps["lane_boundary"], frame.ground_truth.maps["drivable_area"]
        grown = road | np.roll(road, 1, 0) | np.roll(road, -1, 0) | np.roll(road, 1, 1) | np.roll(road, -1, 1)
        assert lines.any()
        assert not (lines & ~grown).any()
        assert lines.sum() < 0.5 * road.sum()


def test_lane_boundaries_run_along_the_drawn_centre_line():
    drive = SyntheticDrive(7, frames=1)
    moment = drive.moment(0)
    mask = drive.frame(0).ground_truth.maps["lane_boundary"]
    lines = [outline for kind, outline in moment.ground if kind == "yellow"][:2]  # either side of the middle
    middle = (lines[0] + lines[1]) / 2
    cells = np.floor((middle[(np.abs(middle) < 51).all(axis=1)] + 51.2) / 0.512).astype(int)
    assert len(cells) > 20
    assert mask[cells[:, 0], cells[:, 1]].mean() > 0.9


def test_the_rig_is_that_of_nuscenes_scaled_and_cut_at_the_top():
    yaws_deg = {"CAM_FRONT": 0, "CAM_FRONT_RIGHT": -55, "CAM_FRONT_LEFT": 55, "CAM_BACK": 180, "CAM_BACK_LEFT": 110,
                "CAM_BACK_RIGHT": -110}  # fmt: skip
    for size, focal, centre in (((400, 160), 316.5, (200, 57.75)), ((800, 320), 633.0, (400, 115.5))):
        cameras = build_rig(4, size)
        assert cameras.keys() == yaws_deg.keys()
        for name, camera in cameras.items():
            expected = focal * 809 / 1266 if name == "CAM_BACK" else focal
            assert camera.intrinsics_px[0, 0] == pytest.approx(expected, rel=0.016)
            assert camera.intrinsics_px[:2, 2] == pytest.approx(centre, abs=0.007 * size[0])
            ahead = camera.camera_T_ego[2, :3]
            off = np.arctan2(ahead[1], ahead[0]) - np.radians(yaws_deg[name])
            assert abs((off + np.pi) % (2 * np.pi) - np.pi) < np.radians(2.1)
            assert abs(ahead[2]) < np.radians(1.5)
            assert np.linalg.det(camera.camera_T_ego[:3, :3]) == pytest.approx(1.0)


@pytest.mark.parametrize("size", [(160, 64), (800, 320)])
def test_a_drive_can_be_drawn_at_another_size(size):
    frame = SyntheticDrive(2, frames=1, image_size=size, grid=(16, 20)).frame(0)
    assert {image.shape for image in frame.images.values()} == {(size[1], size[0], 3)}
    assert {(camera.width_px, camera.height_px) for camera in frame.cameras.values()} == {size}
    assert frame.ground_truth.maps["drivable_area"].shape == (16, 20)
    assert len(frame.ground_truth.boxes) > 5


def test_objects_are_drawn_in_the_same_pixels_under_any_pose():
    painter, cameras = painter_of((400, 160))
    box, mesh = box_at("bus", 18.0, 4.0, 0.4), build_mesh("bus", CLASS_SIZES_M["bus"], np.random.default_rng(0))
    here = painter.paint(np.eye(4), ASPHALT, box[None], [mesh])
    there = painter.paint(rigid(rotation_z(2.0), [812.0, -333.0, 0.0]), ASPHALT, box[None], [mesh])
    assert here["CAM_FRONT"].ids.any()
    assert all(np.array_equal(here[name].ids, there[name].ids) for name in cameras)


@pytest.mark.parametrize("seed", ["", "x", "-1", "1:2:3", "1.5", "1:", "٣", 5000 * "9"])
def test_a_spec_without_whole_numbers_is_refused(seed):
    with pytest.raises(InputError, match=r"expected synthetic:SEED\[:FRAMES\].*got .*for example synthetic:7"):
        SyntheticDrive.parse(f"synthetic:{seed}")


@pytest.mark.parametrize("frames", [0, 100_001])
def test_too_few_or_too_many_frames_are_refused(frames):
    with pytest.raises(InputError, match=f"expected 1 to 100000 frames, got {frames}.*synthetic:3:16"):
        SyntheticDrive.parse(f"synthetic:3:{frames}")


def test_a_spec_gives_seed_and_number_of_frames():
    assert len(SyntheticDrive.parse("synthetic:3")) == 16
    drive = open_source("synthetic:12:5")
    assert len(drive) == len(list(drive)) == 5
    assert drive.frame(0).scene == "synthetic-12"


def test_a_long_drive_goes_on_as_it_began():
    drive = SyntheticDrive(1, frames=100_000)
    frame = drive.frame(99_999)
    assert 8 <= len(frame.ground_truth.boxes) <= 60
    assert frame.ground_truth.maps["drivable_area"].mean() > 0.05


def test_a_frame_is_drawn_in_a_few_hundredths_of_a_second(drive):
    list(drive)
    durations_s = []
    for index in [0, 1, 2, 3, 4] * 4:
        start = time.thread_time()
        drive.frame(index)
        durations_s.append(time.thread_time() - start)
    assert min(durations_s) < 0.06, f"best of {len(durations_s)}: {1000 * min(durations_s):.1f} ms"


def test_true_boxes_are_the_truths_of_the_frames_without_their_ground(drive, monkeypatch):
    expected = [frame.ground_truth.boxes for frame in drive]
    monkeypatch.setattr("duospacenet.synthetic.drive._rasterize", None)
    for index, boxes in enumerate(expected):
        assert len(boxes) > 0
        np.testing.assert_array_equal(drive.ground_truth_boxes(index), boxes)
