"""Stale input: each kind is found, and correct recordings of every frame rate and speed have no findings."""

import tracemalloc
from collections.abc import Callable, Iterable

import cv2
import numpy as np
import pytest

from duospacenet.rig.requirements import RigRequirements
from duospacenet.rig.stale_input import StaleInput
from duospacenet.rig.thumbnails import make_thumbnail, similarity
from duospacenet.runtime.frame import Frame
from duospacenet.runtime.geometry import rigid_transform
from tests.helpers.rigs import AZIMUTHS_DEG, level_camera

SIZE = (192, 108)  # columns and rows
PX_PER_M = 10.0  # the world of a camera passes by like a wall
CAMERAS = {name: level_camera(azimuth) for name, azimuth in AZIMUTHS_DEG.items()}

WORLDS = {
    name: cv2.resize(
        np.random.default_rng(seed).integers(20, 235, (24, 600), np.uint8),
        None,
        fx=4.5,
        fy=4.5,
        interpolation=cv2.INTER_CUBIC,
    )
    for seed, name in enumerate(CAMERAS)
}

NOISE = np.random.default_rng(9).integers(0, 8, (13, SIZE[1], SIZE[0], 3), np.uint8)  # of one exposure each

Changes = Callable[[int, dict[str, np.ndarray | None]], None]  # changes the images of a frame


def image(name: str, position_m: float, exposure: int) -> np.ndarray:
    """The image of a camera that has passed `position_m` of its wall, with the noise of this exposure."""
    left = position_m * PX_PER_M % (WORLDS[name].shape[1] - SIZE[0] - 1)
    shift = np.array([[1.0, 0.0, -left], [0.0, 1.0, 0.0]])
    clean = cv2.warpAffine(WORLDS[name], shift, SIZE)
    return cv2.add(cv2.merge([clean] * 3), NOISE[(7 * exposure + len(name)) % len(NOISE)])


def drive(
    num_frames: int = 12,
    step_m: float = 4.0,
    step_s: float = 0.5,
    change: Changes = lambda index, images: None,
    pose: Callable[[int, float], float] = lambda index, position_m: position_m,
    scene: Callable[[int], str] = lambda index: "scene",
    offset_m: tuple[float, float] = (0.0, 0.0),
) -> Iterable[Frame]:
    """A drive along x. pose: the position that is given for a frame, from its index and its true position [m]."""
    for index in range(num_frames):
        position_m = index * step_m
        images: dict[str, np.ndarray | None] = {name: image(name, position_m, index) for name in CAMERAS}
        change(index, images)
        given = np.array([pose(index, position_m) + offset_m[0], offset_m[1], 0.0])
        yield Frame(images, CAMERAS, rigid_transform(np.eye(3), given), 1.5e9 + index * step_s, scene(index))


def check(frames: Iterable[Frame]) -> StaleInput:
    stale = StaleInput(RigRequirements())
    for index, frame in enumerate(frames):
        stale.add(index, frame)
    return stale


def subjects(stale: StaleInput) -> list[tuple[str, str]]:
    """Camera, or "drive", and subject of each finding."""
    drive_findings = [("drive", finding.subject) for finding in stale.drive_findings()]
    return [(name, finding.subject) for name, finding in stale.camera_findings()] + drive_findings


FINE = {
    "2 Hz": {},
    "20 Hz at walking speed": {"num_frames": 60, "step_m": 0.07, "step_s": 0.05},
    "20 Hz, creeping": {"num_frames": 80, "step_m": 0.01, "step_s": 0.05},
    "10 Hz on a motorway": {"num_frames": 30, "step_m": 3.0, "step_s": 0.1},
    "UTM coordinates": {"offset_m": (691_234.5, 5_334_567.8)},
    "parked": {"num_frames": 30, "step_m": 0.0},
    "parked, with a pose that drifts": {"num_frames": 30, "step_m": 0.0, "pose": lambda index, _: 0.004 * (index % 3)},
    "the pose follows after three frames": {"pose": lambda index, position_m: position_m if index > 2 else 0.0},
    "a frame every 1.9 s": {"step_s": 1.9},
}


@pytest.mark.parametrize("kind", FINE)
def test_a_correct_recording_has_no_finding(kind):
    assert subjects(check(drive(**FINE[kind]))) == []


def test_a_slow_start_has_no_finding():
    """Two seconds at rest, then an acceleration of 1 m/s², at 20 Hz."""
    position_m = [0.5 * max(0.0, index * 0.05 - 2) ** 2 for index in range(120)]
    frames = (
        Frame(
            {name: image(name, position_m[index], index) for name in CAMERAS},
            CAMERAS,
            rigid_transform(np.eye(3), [position_m[index], 0, 0]),
            index * 0.05,
        )
        for index in range(120)
    )
    assert subjects(check(frames)) == []


def frozen_from(start: int, *cameras: str, copy=lambda image: image) -> Changes:
    """The cameras repeat the image of frame `start` in all later frames."""

    def change(index: int, images: dict[str, np.ndarray | None]) -> None:
        for name in cameras:
            if index > start:
                images[name] = copy(image(name, start * 4.0, start))

    return change


def test_a_camera_that_freezes_is_found_with_its_first_frozen_frame():
    stale = check(drive(change=frozen_from(5, "LEFT")))
    assert subjects(stale) == [("LEFT", "frozen image")]
    [(_, finding)] = stale.camera_findings()
    assert (finding.frame, finding.num_frames) == (6, 6)
    assert finding.got == "the same image in frames 5 to 11, while the vehicle moved 24.0 m"


def test_the_last_image_given_once_more_is_found():
    assert subjects(check(drive(num_frames=7, change=frozen_from(5, "LEFT")))) == [("LEFT", "frozen image")]


@pytest.mark.parametrize("quality", [30, 90])
def test_a_frozen_image_is_found_after_compression(quality):
    def compress(image: np.ndarray) -> np.ndarray:
        return cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], cv2.IMREAD_COLOR)

    assert subjects(check(drive(change=frozen_from(2, "BACK", copy=compress)))) == [("BACK", "frozen image")]


def test_all_frozen_cameras_give_one_finding():
    stale = check(drive(change=frozen_from(3, *CAMERAS)))
    assert subjects(stale) == [("drive", "images")]
    [finding] = stale.drive_findings()
    assert "all 4 cameras in frames 3 to 11" in finding.got
    assert "the same images were given again" in finding.cause


def test_cameras_at_half_the_frame_rate_have_no_finding():
    """20 frames per second, and ten images: each image is in two frames."""

    def change(index: int, images: dict[str, np.ndarray | None]) -> None:
        for name in images:
            images[name] = image(name, index // 2 * 2 * 0.6, index // 2)

    assert subjects(check(drive(40, 0.6, 0.05, change))) == []


def test_a_frozen_camera_is_found_across_lost_images():
    def change(index: int, images: dict[str, np.ndarray | None]) -> None:
        frozen_from(2, "LEFT")(index, images)
        if index % 2:
            images["LEFT"] = None

    assert subjects(check(drive(change=change))) == [("LEFT", "frozen image")]


def test_the_same_image_in_another_scene_is_not_frozen():
    stale = check(drive(2, change=frozen_from(0, "LEFT"), scene=str))
    assert subjects(stale) == []


@pytest.mark.parametrize("value", [0, 3, 255])
def test_images_without_content_are_not_called_frozen_or_twins(value):
    def change(index: int, images: dict[str, np.ndarray | None]) -> None:
        for name in ("LEFT", "RIGHT"):
            images[name] = np.full_like(images[name], value)

    assert sorted(subjects(check(drive(change=change)))) == [("LEFT", "image content"), ("RIGHT", "image content")]


def test_a_dark_night_with_noise_is_not_called_frozen_or_twins():
    def change(index: int, images: dict[str, np.ndarray | None]) -> None:
        for name, before in images.items():
            light = np.linspace(0, 20, SIZE[0], dtype=np.uint8)[None, :, None]
            images[name] = before // 50 + light + NOISE[(5 * index + len(name)) % len(NOISE)]

    assert subjects(check(drive(change=change))) == []
    assert subjects(check(drive(step_m=0.0, change=change))) == []


def test_an_image_given_for_two_cameras_is_found():
    def change(index: int, images: dict[str, np.ndarray | None]) -> None:
        if index >= 4:
            images["RIGHT"] = images["LEFT"]

    stale = check(drive(change=change))
    assert subjects(stale) == [("RIGHT", "image compared with LEFT")]
    [(_, finding)] = stale.camera_findings()
    assert (finding.frame, finding.num_frames) == (4, 8)


def test_a_rescaled_image_given_for_two_cameras_is_found():
    def change(index: int, images: dict[str, np.ndarray | None]) -> None:
        small = cv2.resize(images["LEFT"], (240, 135), interpolation=cv2.INTER_AREA)
        images["RIGHT"] = cv2.resize(small, (600, 338))

    assert subjects(check(drive(change=change))) == [("RIGHT", "image compared with LEFT")]


CONSTANT = {
    "bit-equal": (lambda index, _: 0.0, "one pose was given"),
    "in degrees of latitude": (lambda index, position_m: 48.1 + position_m / 111_000, "degrees of latitude"),
    "in kilometres": (lambda index, position_m: position_m / 1000, "in kilometres"),
    "with rounding errors": (lambda index, _: 1e-9 * (index % 2), "degrees of latitude"),
}


@pytest.mark.parametrize("kind", CONSTANT)
@pytest.mark.parametrize("num_frames", [3, 12])
def test_a_constant_pose_of_a_moving_vehicle_is_found(kind, num_frames):
    pose, words = CONSTANT[kind]
    stale = check(drive(num_frames, pose=pose))
    assert subjects(stale) == [("drive", "ego pose")]
    [finding] = stale.drive_findings()
    assert words in finding.cause
    assert f"in frames 0 to {num_frames - 1}" in finding.got


@pytest.mark.parametrize(("step_m", "step_s"), [(4.0, 0.5), (0.5, 0.05), (0.1, 0.05)])
def test_a_pose_that_stops_during_the_drive_is_found_at_every_frame_rate(step_m, step_s):
    frames = drive(60, step_m, step_s, pose=lambda index, position_m: min(position_m, 10 * step_m))
    stale = check(frames)
    assert subjects(stale) == [("drive", "ego pose")]
    [finding] = stale.drive_findings()
    assert finding.frame == 10


def test_traffic_around_a_parked_vehicle_does_not_make_its_pose_stale():
    """A large vehicle covers 25 % of every camera's image, at another place in each frame."""

    def change(index: int, images: dict[str, np.ndarray | None]) -> None:
        for name in images:
            left = index * 61 % (SIZE[0] * 3 // 4)
            images[name][:, left : left + SIZE[0] // 4] = 90 + index

    assert subjects(check(drive(30, 0.0, change=change))) == []


RESETS = {
    "milliseconds": ({"step_s": 100.0}, "gap of 100.00 s", "the times are not in seconds"),
    "microseconds": ({"step_s": 5e5}, "gap of 500000.00 s", "the times are not in seconds"),
    "3 s between frames": ({"step_s": 3.0}, "gap of 3.00 s", "most frames are missing"),
    "one scene per frame": ({"scene": str}, "new scene '1' after '0'", "a name of the frame"),
    "millimetres": ({"pose": lambda _, position_m: 1000 * position_m}, "ego jump of 4000.0 m", "not in metres"),
}


@pytest.mark.parametrize("kind", RESETS)
def test_a_history_that_is_dropped_at_every_frame_is_found(kind):
    changes, reason, words = RESETS[kind]
    stale = check(drive(**changes))
    assert subjects(stale) == [("drive", "history")]
    [finding] = stale.drive_findings()
    assert f"at 11 of 11 frames after the first: {reason}" in finding.got
    assert words in finding.cause


def test_a_few_scenes_in_one_source_have_no_finding():
    assert subjects(check(drive(12, scene=lambda index: str(index // 4)))) == []
    assert subjects(check(drive(3, scene=str))) == []


def test_findings_appear_with_the_frame_that_shows_them():
    stale, found = StaleInput(RigRequirements()), []
    for index, frame in enumerate(drive(change=frozen_from(5, "LEFT"), pose=lambda index, _: -0.0)):
        stale.add(index, frame)
        found.append([finding.subject for finding in stale.drive_findings(is_complete=False)])
    assert found == [[]] * 4 + [["ego pose"]] * 8


def test_no_image_is_kept():
    stale = StaleInput(RigRequirements())
    frames = list(drive(3))
    stale.add(0, frames[0])
    tracemalloc.start()
    for index, frame in enumerate(frames[1:], start=1):
        stale.add(index, frame)
    kept = tracemalloc.take_snapshot().statistics("filename")
    tracemalloc.stop()
    assert sum(each.size for each in kept) < 60_000  # two frames have 500 KB


def test_similarity_is_the_correlation_of_the_details():
    one = make_thumbnail(image("LEFT", 0, 0))
    other = make_thumbnail(image("LEFT", 1, 1))
    expected = np.corrcoef(one.detail.ravel(), other.detail.ravel())[0, 1]
    assert similarity(one, other) == pytest.approx(expected, abs=1e-4)
    assert np.isnan(similarity(one, make_thumbnail(np.zeros((216, 384, 3), np.uint8))))
