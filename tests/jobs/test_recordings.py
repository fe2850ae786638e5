"""Recordings of a run, read back with the readers of their formats."""

import json
import os
import subprocess
import sys
from dataclasses import replace

import cv2
import numpy as np
import pytest

from duospacenet import jobs
from duospacenet.data.results import read_results
from duospacenet.jobs import recordings
from duospacenet.jobs.recordings import check_recordable, check_recording
from duospacenet.runtime.errors import InputError, OutputError, UsageError
from duospacenet.runtime.geometry import rotation_from_quaternion
from duospacenet.synthetic.drive import SyntheticDrive
from tests.helpers.recordings import blueprints, read_mcap, read_rrd

DRIVE = "synthetic:5:3"
MIN_SCORE = 0.15
SUFFIXES = [".mcap", ".rrd"]


@pytest.fixture(scope="module")
def frames():
    return list(SyntheticDrive.parse(DRIVE))


@pytest.fixture(scope="module")
def recorded(tiny_bundle, tmp_path_factory):
    """A run with maps, recorded in both formats, and its folder."""
    folder = tmp_path_factory.mktemp("recorded")
    for suffix in SUFFIXES:
        options = {"recording": folder / f"drive{suffix}", "overwrite": True, "min_score": MIN_SCORE}
        jobs.run(tiny_bundle, DRIVE, folder / "run", maps=True, **options)
    return folder


@pytest.fixture(scope="module")
def messages(recorded):
    return read_mcap(recorded / "drive.mcap")


@pytest.fixture(scope="module")
def entities(recorded):
    return read_rrd(recorded / "drive.rrd")


@pytest.fixture(scope="module")
def results(recorded):
    return list(read_results(recorded / "run" / "results.jsonl"))


def numbers(message, names="xyz"):
    return [getattr(message, name) for name in names]


def pose(translation, rotation):
    matrix = np.eye(4)
    matrix[:3, :3] = rotation_from_quaternion(np.array(numbers(rotation, "wxyz")))
    matrix[:3, 3] = numbers(translation)
    return matrix


def kept(result):
    return [box for box in result["boxes"] if box["score"] >= MIN_SCORE]


class TestFoxglove:
    def test_every_topic_has_one_message_per_frame_at_its_time(self, messages, frames):
        cameras = [f"/{name}/{kind}" for name in frames[0].cameras for kind in ("image", "calibration")]
        others = ["/tf", "/detections", "/ground_truth", "/map/drivable_area", "/map/lane_boundary"]
        assert set(messages) == {*cameras, *others}
        for topic, rows in messages.items():
            assert [time / 1e9 for time, _ in rows] == pytest.approx([f.timestamp_s for f in frames], abs=1e-6), topic

    def test_the_frames_are_chained_from_global_to_the_cameras(self, messages, frames):
        for (_, message), frame in zip(messages["/tf"], frames, strict=True):
            poses = {(t.parent_frame_id, t.child_frame_id): pose(t.translation, t.rotation) for t in message.transforms}
            np.testing.assert_allclose(poses.pop(("global", "ego")), frame.global_T_ego, atol=1e-6)
            assert set(poses) == {("ego", name) for name in frame.cameras}
            for (_, name), ego_T_camera in poses.items():
                np.testing.assert_allclose(ego_T_camera @ frame.cameras[name].camera_T_ego, np.eye(4), atol=1e-6)

    def test_the_calibration_has_its_first_pixel_at_zero(self, messages, frames):
        name, camera = next(iter(frames[1].cameras.items()))
        calibration = messages[f"/{name}/calibration"][1][1]
        assert (calibration.frame_id, calibration.width, calibration.height) == (
            name,
            camera.width_px,
            camera.height_px,
        )
        # A ray to the centre of the first pixel, (0.5, 0.5) in our convention, goes to (0, 0) in Foxglove's.
        ray = np.linalg.inv(camera.intrinsics_px) @ [0.5, 0.5, 1]
        np.testing.assert_allclose(np.array(calibration.K).reshape(3, 3) @ ray, [0, 0, 1], atol=1e-9)
        np.testing.assert_allclose(np.array(calibration.P).reshape(3, 4)[:, :3].ravel(), calibration.K)

    def test_the_images_are_those_of_the_cameras(self, messages, frames):
        for name in frames[2].cameras:
            message = messages[f"/{name}/image"][2][1]
            assert (message.format, message.frame_id) == ("jpeg", name)
            image = cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_COLOR)
            assert np.abs(image.astype(int) - frames[2].images[name]).mean() < 3

    def test_the_boxes_are_those_of_the_results_and_of_the_ground_truth(self, messages, frames, results):
        for index, (frame, result) in enumerate(zip(frames, results, strict=True)):
            truth = [(*box[:3], *box[[4, 3, 5]], np.cos(box[6]), np.sin(box[6])) for box in frame.ground_truth.boxes]
            predictions = [
                (*b["center_m"], *np.array(b["size_wlh_m"])[[1, 0, 2]], np.cos(b["yaw_rad"]), np.sin(b["yaw_rad"]))
                for b in kept(result)
            ]
            for topic, expected in (("/ground_truth", truth), ("/detections", predictions)):
                scene = messages[topic][index][1]
                assert [deletion.type for deletion in scene.deletions] == [1]  # all boxes of the frame before
                boxes = []
                for entity in scene.entities:
                    assert entity.frame_id == "ego"
                    [cube] = entity.cubes
                    x_axis = pose(cube.pose.position, cube.pose.orientation)[:2, 0]
                    boxes.append((*numbers(cube.pose.position), *numbers(cube.size), *x_axis))
                assert len(boxes) == len(expected) > 0
                np.testing.assert_allclose(boxes, expected, atol=1e-5)
        first = kept(results[0])[0]
        assert messages["/detections"][0][1].entities[0].texts[0].text == f"{first['class']} {first['score']:.2f}"

    def test_arrows_point_along_the_velocity(self, messages, frames):
        boxes = frames[1].ground_truth.boxes
        for entity, box in zip(messages["/ground_truth"][1][1].entities, boxes, strict=True):
            speed = np.hypot(*box[7:9])
            assert len(entity.arrows) == int(speed >= 0.3)
            for arrow in entity.arrows:
                direction = pose(arrow.pose.position, arrow.pose.orientation)[:2, 0]
                length = arrow.shaft_length + arrow.head_length
                np.testing.assert_allclose(length * direction, box[7:9], atol=1e-6)

    def test_a_cell_of_the_map_is_at_its_place_in_the_ego_frame(self, messages, recorded):
        mask = cv2.imread(str(recorded / "run" / "maps" / "000001_drivable_area.png"), cv2.IMREAD_GRAYSCALE)
        grid = messages["/map/drivable_area"][1][1]
        assert [field.name for field in grid.fields] == ["red", "green", "blue", "alpha"]
        cells = np.frombuffer(grid.data, np.uint8).reshape(-1, grid.column_count, 4)
        assert cells.shape[:2] == mask.shape[::-1]
        assert mask.std() > 1
        for i, j in ((0, 0), (3, 11), (14, 2)):  # column i is at x, row j at y
            assert cells[j, i, 3] == mask[i, j]
        assert numbers(grid.pose.position) == pytest.approx([-51.2, -51.2, 0])
        assert numbers(grid.cell_size, "xy") == pytest.approx([102.4 / mask.shape[0], 102.4 / mask.shape[1]])


class TestRerun:
    def test_the_ego_moves_and_the_cameras_stay(self, entities, frames):
        poses = entities["/world/ego"]
        assert [row["frame"] for row in poses] == [0, 1, 2]
        origin = frames[0].global_T_ego[:3, 3]
        for row, frame in zip(poses, frames, strict=True):
            assert row["time"].timestamp() == pytest.approx(frame.timestamp_s, abs=1e-5)
            [translation], [matrix] = row["Transform3D:translation"], row["Transform3D:mat3x3"]
            np.testing.assert_allclose(translation, frame.global_T_ego[:3, 3] - origin, atol=1e-4)
            np.testing.assert_allclose(np.reshape(matrix, (3, 3)).T, frame.global_T_ego[:3, :3], atol=1e-6)

    def test_images_have_the_calibration_of_their_cameras(self, entities, frames):
        for name, camera in frames[0].cameras.items():
            row = {k: v for each in entities[f"/world/ego/cameras/{name}"] for k, v in each.items() if v is not None}
            [matrix] = row["Pinhole:image_from_camera"]
            np.testing.assert_allclose(np.reshape(matrix, (3, 3)).T, camera.intrinsics_px, rtol=1e-6)
            image = entities[f"/world/ego/cameras/{name}/image"][2]["EncodedImage:blob"][0]
            decoded = cv2.imdecode(np.array(image, np.uint8), cv2.IMREAD_COLOR)
            assert np.abs(decoded.astype(int) - frames[2].images[name]).mean() < 3

    def test_the_boxes_are_those_of_the_results_and_of_the_ground_truth(self, entities, frames, results):
        for index, frame in enumerate(frames):
            truth = frame.ground_truth.boxes
            row = entities["/world/ego/ground_truth/boxes"][index]
            np.testing.assert_allclose(row["Boxes3D:centers"], truth[:, :3], atol=1e-4)
            np.testing.assert_allclose(2 * np.array(row["Boxes3D:half_sizes"]), truth[:, [4, 3, 5]], atol=1e-4)
            x, y, z, w = np.array(row["Boxes3D:quaternions"]).T
            np.testing.assert_allclose([x, y], 0, atol=1e-6)
            np.testing.assert_allclose(np.cos(2 * np.arctan2(z, w) - truth[:, 6]), 1, atol=1e-6)
            row = entities["/world/ego/detections/boxes"][index]
            assert row["Boxes3D:labels"] == [f"{box['class']} {box['score']:.2f}" for box in kept(results[index])]

    def test_the_first_row_of_the_map_is_the_leftmost_one(self, entities, recorded):
        mask = cv2.imread(str(recorded / "run" / "maps" / "000001_drivable_area.png"), cv2.IMREAD_GRAYSCALE)
        row = entities["/world/ego/map/drivable_area"][1]
        pixels = np.array(row["GridMap:data"][0], np.uint8).reshape(*mask.shape[::-1], 4)
        np.testing.assert_array_equal(pixels[..., 3], mask[:, ::-1].T)
        assert row["GridMap:cell_size"] == pytest.approx([102.4 / len(mask)])

    def test_the_file_has_a_blueprint(self, recorded):
        assert blueprints(recorded / "drive.rrd") == 1


def interrupt_at(monkeypatch, index):
    """Let the recording of this frame raise KeyboardInterrupt."""
    add = recordings.RecordingWriter.add

    def add_until(writer, processed):
        if processed.index == index:
            raise KeyboardInterrupt
        add(writer, processed)

    monkeypatch.setattr(recordings.RecordingWriter, "add", add_until)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_an_interrupted_run_leaves_a_valid_recording_which_a_resumed_run_completes(
    tiny_bundle, tmp_path, monkeypatch, suffix, results
):
    path = tmp_path / f"drive{suffix}"
    options = {"maps": True, "recording": path, "min_score": MIN_SCORE}
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        interrupt_at(patch, 2)
        jobs.run(tiny_bundle, DRIVE, tmp_path / "run", **options)
    assert number_of_frames(path) == 2
    jobs.run(tiny_bundle, DRIVE, tmp_path / "run", resume=True, **options)
    assert number_of_frames(path) == 3
    assert labels(path) == [[f"{box['class']} {box['score']:.2f}" for box in kept(result)] for result in results]
    assert sorted(each.name for each in tmp_path.iterdir()) == [path.name, "run"]  # no temporary file


def number_of_frames(path):
    return len(read_mcap(path)["/tf"]) if path.suffix == ".mcap" else len(read_rrd(path)["/world/ego"])


def labels(path):
    if path.suffix == ".rrd":
        return [row["Boxes3D:labels"] for row in read_rrd(path)["/world/ego/detections/boxes"]]
    return [[each.texts[0].text for each in scene.entities] for _, scene in read_mcap(path)["/detections"]]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_complete_recording_is_kept_if_a_new_run_fails(tiny_bundle, recorded, tmp_path, monkeypatch, suffix):
    path = tmp_path / f"drive{suffix}"
    path.write_bytes((recorded / path.name).read_bytes())
    interrupt_at(monkeypatch, 1)
    with pytest.raises(KeyboardInterrupt):
        jobs.run(tiny_bundle, DRIVE, tmp_path / "run", recording=path, overwrite=True)
    assert path.read_bytes() == (recorded / path.name).read_bytes()
    assert not [each for each in tmp_path.iterdir() if each.name.startswith(".")]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_full_disk_ends_the_run_and_leaves_no_recording(tiny_bundle, tmp_path, suffix):
    code = (
        "import resource, signal, sys; signal.signal(signal.SIGXFSZ, signal.SIG_IGN); "
        "resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, resource.RLIM_INFINITY)); "
        "from duospacenet.cli.main import main; main()"
    )
    path = tmp_path / f"drive{suffix}"
    arguments = ["run", tiny_bundle, "synthetic:5:6", "--out", tmp_path / "run", "--recording", path]
    command = [sys.executable, "-c", code, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 5, done.stderr
    assert f"cannot write {path}: " in done.stderr
    assert "Traceback" not in done.stderr
    assert [each.name for each in tmp_path.iterdir()] == ["run"]
    lines = (tmp_path / "run" / "results.jsonl").read_text().splitlines()
    assert all(json.loads(line) for line in lines)


class TestChecks:
    def test_other_suffixes_are_refused(self, tmp_path):
        with pytest.raises(UsageError, match=r"--recording: expected a file name that ends with .mcap or .rrd"):
            check_recording(tmp_path / "drive.mp4", may_replace=True)

    def test_files_of_other_programs_are_never_replaced(self, tmp_path):
        path = tmp_path / "drive.mcap"
        path.write_bytes(b"\x89MCAP0\r\nmy only drive")
        for may_replace in (False, True):
            with pytest.raises(OutputError, match="this toolkit did not write this file"):
                check_recording(path, may_replace)
        os.mkfifo(tmp_path / "pipe.mcap")
        (tmp_path / "folder.rrd").mkdir()
        for name in ("pipe.mcap", "folder.rrd"):
            with pytest.raises(OutputError):
                check_recording(tmp_path / name, may_replace=True)

    @pytest.mark.parametrize("suffix", SUFFIXES)
    def test_earlier_recordings_are_replaced_on_request_only(self, recorded, suffix):
        path = recorded / f"drive{suffix}"
        with pytest.raises(OutputError, match="add --overwrite or --resume"):
            check_recording(path, may_replace=False)
        check_recording(path, may_replace=True)

    def test_a_path_that_is_not_utf8_is_refused(self, tmp_path):
        with pytest.raises(UsageError, match="expected a path in UTF-8"):
            check_recording(tmp_path / "\udcff.rrd", may_replace=False)

    @pytest.mark.parametrize(
        ("times", "message"),
        [
            ([("a", -1.0)], "frame 0: --recording: expected times from 0"),
            ([("a", 0.0), ("a", 5e9)], "frame 1: --recording: expected times from 0"),
            ([("a", 0.0), ("a", 2.0), ("b", 1.0), ("b", 3.0)], "scenes 'a' and 'b' overlap at 1.0 s"),
            ([("a", 5.0), ("b", 4.0), ("b", 5.0)], "scenes 'b' and 'a' overlap at 5.0 s"),
        ],
    )
    def test_times_that_have_no_place_on_one_time_line_are_refused(self, frames, times, message):
        with pytest.raises(InputError, match=message):
            check_recordable(Times(frames[0], times))

    def test_scenes_may_be_in_any_order_of_time(self, frames):
        check_recordable(Times(frames[0], [("b", 10.0), ("b", 11.0), ("a", 0.0), ("a", 1.0)]))


class Times:
    """A source of which only scenes and times are known."""

    def __init__(self, frame, times):
        self._frame, self._times = frame, times

    def __len__(self):
        return len(self._times)

    def frame_without_images(self, index):
        scene, timestamp_s = self._times[index]
        return replace(self._frame, scene=scene, timestamp_s=timestamp_s)
