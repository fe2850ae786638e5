"""A synthetic drive: reproducible from its seed, with exact ground truth."""

import pickle

import numpy as np
import pytest

from duospacenet.jobs.sources import open_source
from duospacenet.runtime.errors import InputError
from duospacenet.synthetic.drive import SyntheticDrive
from tests.helpers.synthetic_scenes import CLASS_ORDER


@pytest.fixture(scope="module")
def drive() -> SyntheticDrive:
    return SyntheticDrive(7, frames=6)


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


def test_a_frame_does_not_depend_on_which_frames_were_rendered_before():
    last = list(SyntheticDrive(5, frames=4))[3]
    alone = SyntheticDrive(5, frames=4).frame(3)
    assert np.array_equal(last.ground_truth.boxes, alone.ground_truth.boxes)
    assert all(np.array_equal(last.images[name], alone.images[name]) for name in last.images)


def test_a_copy_in_another_process_gives_the_same_frames():
    """Also after the drive has generated its streets."""
    drive = SyntheticDrive(3, 2, image_size=(64, 32), grid=(8, 12))
    expected = drive.frame(1)
    copied = pickle.loads(pickle.dumps(drive)).frame(1)
    assert expected.images.keys() == copied.images.keys()
    assert all(np.array_equal(image, copied.images[name]) for name, image in expected.images.items())
    np.testing.assert_array_equal(copied.ground_truth.boxes, expected.ground_truth.boxes)
    assert copied.ground_truth.maps["drivable_area"].shape == (8, 12)


def test_different_seeds_give_different_drives():
    a, b = next(iter(SyntheticDrive(1, frames=1))), next(iter(SyntheticDrive(2, frames=1)))
    assert a.timestamp_s != b.timestamp_s
    assert not np.allclose(a.global_T_ego, b.global_T_ego)
    assert all((a.images[name] != b.images[name]).mean() > 0.5 for name in a.images)
    assert not np.array_equal(a.cameras["CAM_BACK"].intrinsics_px, b.cameras["CAM_BACK"].intrinsics_px)


def test_frames_are_at_two_hertz_and_the_ego_moves_like_a_car(drive):
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


def test_a_frame_has_the_name_of_its_scene_and_a_token(drive):
    assert drive.frame(3).scene == "synthetic-7"
    assert drive.frame(3).token == "synthetic-7-000003"


def test_the_ground_truth_contains_all_visible_objects_within_range_with_their_exact_boxes(drive):
    for index, frame in enumerate(drive):
        boxes, snapshot = frame.ground_truth.boxes, drive.key_frame(index).snapshot
        assert boxes.dtype == np.float64
        assert boxes.shape == (len(frame.ground_truth.classes), 9)
        assert np.all(np.abs(boxes[:, :2]) <= 51.2)
        assert np.all((boxes[:, 6] > -np.pi) & (boxes[:, 6] <= np.pi))
        assert np.allclose(boxes[:, 2], boxes[:, 5] / 2)
        expected = list(visible_objects(snapshot, drive.render(drive.key_frame(index)).values()))
        assert len(expected) >= 8
        assert list(zip(frame.ground_truth.classes, boxes.tolist(), strict=True)) == expected


def visible_objects(snapshot, rendered):
    """Name and box of each object within range that has 4 pixels, and 15 % of its unoccluded pixels, in one image."""
    for i, (name, box) in enumerate(zip(snapshot.names, snapshot.boxes.tolist(), strict=True)):
        pixels = [((image.ids == i + 1).sum(), image.num_unoccluded[i]) for image in rendered]
        is_visible = any(visible >= 4 and visible >= 0.15 * unoccluded for visible, unoccluded in pixels)
        if name in CLASS_ORDER and max(abs(box[0]), abs(box[1])) <= 51.2 and is_visible:
            yield name, box


@pytest.mark.parametrize("size", [(160, 64), (800, 320)])
def test_a_drive_can_be_rendered_at_another_image_size(size):
    frame = SyntheticDrive(2, frames=1, image_size=size, grid=(16, 20)).frame(0)
    assert {image.shape for image in frame.images.values()} == {(size[1], size[0], 3)}
    assert {(camera.width_px, camera.height_px) for camera in frame.cameras.values()} == {size}
    assert frame.ground_truth.maps["drivable_area"].shape == (16, 20)
    assert len(frame.ground_truth.boxes) > 5


@pytest.mark.parametrize("seed", ["", "x", "-1", "1:2:3", "1.5", "1:", "٣", 5000 * "9"])
def test_a_specification_without_whole_numbers_is_refused(seed):
    with pytest.raises(InputError, match=r"expected synthetic:SEED\[:FRAMES\].*got .*for example synthetic:7"):
        SyntheticDrive.parse(f"synthetic:{seed}")


@pytest.mark.parametrize("frames", [0, 100_001])
def test_too_few_or_too_many_frames_are_refused(frames):
    with pytest.raises(InputError, match=f"expected 1 to 100000 frames, got {frames}.*synthetic:3:16"):
        SyntheticDrive.parse(f"synthetic:3:{frames}")


def test_a_specification_gives_the_seed_and_the_number_of_frames():
    assert len(SyntheticDrive.parse("synthetic:3")) == 16
    drive = open_source("synthetic:12:5")
    assert len(drive) == len(list(drive)) == 5
    assert drive.frame(0).scene == "synthetic-12"


def test_the_last_frame_of_a_long_drive_has_objects_and_road():
    drive = SyntheticDrive(1, frames=100_000)
    frame = drive.frame(99_999)
    assert 8 <= len(frame.ground_truth.boxes) <= 60
    assert frame.ground_truth.maps["drivable_area"].mean() > 0.05


def test_a_frame_without_images_renders_nothing_and_generates_no_objects(drive, monkeypatch):
    frames = list(drive)
    monkeypatch.setattr("duospacenet.synthetic.renderer.Renderer.render", None)
    monkeypatch.setattr("duospacenet.synthetic.world.World.snapshot", None)
    monkeypatch.setattr("duospacenet.synthetic.map_masks._rasterise", None)
    for index, frame in enumerate(frames):
        bare = drive.frame_without_images(index)
        assert bare.images == dict.fromkeys(frame.cameras)
        assert bare.ground_truth is None
        assert (bare.timestamp_s, bare.token) == (frame.timestamp_s, frame.token)
        np.testing.assert_array_equal(bare.global_T_ego, frame.global_T_ego)


def test_the_ground_truth_without_maps_is_that_of_the_frames_and_needs_no_map_masks(drive, monkeypatch):
    expected = [frame.ground_truth for frame in drive]
    monkeypatch.setattr("duospacenet.synthetic.map_masks._rasterise", None)
    for index, ground_truth in enumerate(expected):
        without_maps = drive.ground_truth_without_maps(index)
        assert len(ground_truth.boxes) > 0
        assert without_maps.classes == ground_truth.classes
        assert without_maps.maps == {}
        np.testing.assert_array_equal(without_maps.boxes, ground_truth.boxes)
