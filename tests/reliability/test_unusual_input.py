"""Row T10 for `run` and `eval`: impossible calibrations are refused, implausible input is reported once."""

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from duospacenet import jobs
from duospacenet.cli.main import run_app
from duospacenet.data.scene_writer import write_scene
from duospacenet.synthetic.drive import SyntheticDrive
from tests.helpers.output_files import contents
from tests.helpers.scene_files import copy_tree, edit_scene
from tests.helpers.streams import TINY_SIZE_PX

NUM_FRAMES = 9

Change = Callable[[dict], object]


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("scenes") / "scene"
    write_scene(folder, SyntheticDrive(5, frames=NUM_FRAMES, image_size=TINY_SIZE_PX))
    return folder


@pytest.fixture(scope="module")
def clean(tiny_bundle, scene, tmp_path_factory) -> bytes:
    """The results of the unchanged scene."""
    out = tmp_path_factory.mktemp("clean")
    assert run_app(["run", str(tiny_bundle), str(scene), "--out", str(out)]) == 0
    return (out / "results.jsonl").read_bytes()


def change_extrinsics(change: Callable[[np.ndarray], np.ndarray], *names: str) -> Change:
    """Change camera_T_ego of these cameras, or of all."""

    def edit(record: dict) -> None:
        for name in names or record["cameras"]:
            camera = record["cameras"][name]
            camera["camera_T_ego"] = change(np.array(camera["camera_T_ego"])).tolist()

    return edit


def scale_translation(factor: float) -> Callable[[np.ndarray], np.ndarray]:
    scale = np.ones((4, 4))
    scale[:3, 3] = factor
    return lambda camera_T_ego: camera_T_ego * scale


def mirror(camera_T_ego: np.ndarray) -> np.ndarray:
    return np.diag([-1.0, 1, 1, 1]) @ camera_T_ego


def copy_calibration(record: dict) -> None:
    record["cameras"]["CAM_BACK_LEFT"] = record["cameras"]["CAM_FRONT"]


REFUSED: dict[str, tuple[Change, list[str]]] = {
    "one camera inverted": (
        change_extrinsics(np.linalg.inv, "CAM_BACK_LEFT"),
        ["camera CAM_BACK_LEFT: pose", "inverse"],
    ),
    "all cameras inverted": (change_extrinsics(np.linalg.inv), ["cameras CAM_FRONT", "CAM_BACK: pose", "inverse"]),
    "millimetres": (change_extrinsics(scale_translation(1000)), ["cameras CAM_", "millimetres"]),
    "one camera in millimetres": (change_extrinsics(scale_translation(1000), "CAM_BACK"), ["camera CAM_BACK", "milli"]),
    "mirrored": (change_extrinsics(mirror, "CAM_FRONT"), ["camera CAM_FRONT", "determinant"]),
    "one calibration under two names": (copy_calibration, ["CAM_BACK_LEFT", "pose"]),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_t10_a_calibration_that_cannot_be_right_is_refused_before_the_first_frame(
    tiny_bundle, scene, tmp_path, capfd, kind
):
    change, words = REFUSED[kind]
    edit_scene(copy_tree(scene, tmp_path / "scene"), change)
    arguments = [str(tiny_bundle), str(tmp_path / "scene")]
    for command in (["run", *arguments, "--out", str(tmp_path / "out")], ["eval", *arguments]):
        assert run_app(command) == 3
        printed = capfd.readouterr()
        assert printed.out == ""
        for word in ("error: ", *words):
            assert word in printed.err
    assert not (tmp_path / "out").exists()


def test_t10_a_refused_calibration_runs_with_no_check_and_a_warning(tiny_bundle, scene, tmp_path, capfd):
    edit_scene(copy_tree(scene, tmp_path / "scene"), change_extrinsics(scale_translation(1000)))
    arguments = ["run", str(tiny_bundle), str(tmp_path / "scene"), "--out", str(tmp_path / "out"), "--no-check"]
    assert run_app(arguments) == 0
    assert "warning: frame 0, cameras CAM_" in capfd.readouterr().err


def freeze(name: str) -> Change:
    """The camera gives the image of frame 5 in all later frames."""

    def edit(record: dict) -> None:
        for frame in record["frames"][6:]:
            frame["cameras"][name]["image"] = record["frames"][5]["cameras"][name]["image"]

    return edit


def freeze_all(record: dict) -> None:
    for name in record["cameras"]:
        freeze(name)(record)


def change_frames(change: Callable[[int, dict], object]) -> Change:
    def edit(record: dict) -> None:
        for index, frame in enumerate(record["frames"]):
            change(index, frame)

    return edit


def scale_times(factor: float) -> Change:
    def edit(record: dict) -> None:
        start_s = record["frames"][0]["timestamp_s"]
        for frame in record["frames"]:
            frame["timestamp_s"] = (frame["timestamp_s"] - start_s) * factor

    return edit


def scale_positions(factor: float) -> Change:
    def change(_: int, frame: dict) -> None:
        for row in frame["global_T_ego"][:3]:
            row[3] *= factor

    return change_frames(change)


def same_image(_: int, frame: dict) -> None:
    frame["cameras"]["CAM_BACK"]["image"] = frame["cameras"]["CAM_FRONT"]["image"]


IDENTITY = np.eye(4).tolist()

WARNED: dict[str, tuple[Change, list[str]]] = {
    "a frozen camera": (freeze("CAM_BACK"), ["frame 6, camera CAM_BACK: frozen image"]),
    "all cameras frozen": (freeze_all, ["same images of all 6 cameras in frames 5 to"]),
    "a constant pose": (change_frames(lambda _, frame: frame.update(global_T_ego=IDENTITY)), ["ego pose", "same pose"]),
    "degrees of latitude": (scale_positions(9e-6), ["ego pose", "degrees of latitude"]),
    "millimetres": (scale_positions(1000), ["history", "8 of 8 frames"]),
    "milliseconds": (scale_times(1000), ["history", "8 of 8 frames"]),
    "microseconds": (scale_times(1e6), ["history", "8 of 8 frames"]),
    "a scene for each frame": (
        change_frames(lambda index, frame: frame.update(scene=f"frame {index}")),
        ["history", "new scene 'frame 1' after 'frame 0'"],
    ),
    "one image for two cameras": (change_frames(same_image), ["camera CAM_BACK", "the image of CAM_FRONT"]),
}


@pytest.mark.parametrize("kind", WARNED)
def test_t10_stale_or_implausible_input_is_reported_once(tiny_bundle, scene, tmp_path, capfd, kind):
    change, words = WARNED[kind]
    edit_scene(copy_tree(scene, tmp_path / "scene"), change)
    arguments = ["run", str(tiny_bundle), str(tmp_path / "scene"), "--out", str(tmp_path / "out"), "--json"]
    assert run_app(arguments) == 0
    printed = capfd.readouterr()
    warnings = [line.removeprefix("warning: ") for line in printed.err.splitlines() if line.startswith("warning: ")]
    assert warnings
    assert len(set(warnings)) == len(warnings) <= 3
    assert any(all(word in warning for word in words) for warning in warnings), warnings
    assert len(json.loads(printed.out)["warnings"]) == len(warnings)


def test_t10_a_lost_camera_given_as_black_images_is_reported(tiny_bundle, scene, tmp_path, capfd):
    copy_tree(scene, tmp_path / "scene")
    for path in (tmp_path / "scene" / "images" / "CAM_BACK").iterdir():
        cv2.imwrite(str(path), np.zeros((TINY_SIZE_PX[1], TINY_SIZE_PX[0], 3), np.uint8))
    assert run_app(["run", str(tiny_bundle), str(tmp_path / "scene"), "--out", str(tmp_path / "out")]) == 0
    printed = capfd.readouterr().err
    assert printed.count("warning: ") == 1
    assert "warning: frame 0, camera CAM_BACK: image content" in printed


def move_far(_: int, frame: dict) -> None:
    frame["global_T_ego"][0][3] += 691_000.0
    frame["global_T_ego"][1][3] += 5_334_000.0


FINE: dict[str, Change] = {
    "unchanged": lambda record: None,
    "UTM coordinates": change_frames(move_far),
    "10 Hz": scale_times(0.2),
    "a pose that starts late": lambda record: [
        frame.update(global_T_ego=record["frames"][2]["global_T_ego"]) for frame in record["frames"][:2]
    ],
}


@pytest.mark.parametrize("kind", FINE)
def test_t10_correct_input_gives_no_warning(tiny_bundle, scene, tmp_path, kind):
    edit_scene(copy_tree(scene, tmp_path / "scene"), FINE[kind])
    assert jobs.run(tiny_bundle, tmp_path / "scene", tmp_path / "out").warnings == ()


def test_t10_warnings_change_no_result(tiny_bundle, scene, clean, tmp_path):
    """The warning is about image files that have another name, but the same content."""
    copy_tree(scene, tmp_path / "scene")
    summary = jobs.run(tiny_bundle, tmp_path / "scene", tmp_path / "out", notify=pytest.fail)
    assert summary.warnings == ()
    assert (tmp_path / "out" / "results.jsonl").read_bytes() == clean


def test_t10_eval_reports_each_source_once(tiny_bundle, scene, tmp_path, capfd):
    for name in ("one", "other"):
        edit_scene(copy_tree(scene, tmp_path / name), freeze("CAM_BACK"))
    assert run_app(["eval", str(tiny_bundle), str(tmp_path / "one"), str(tmp_path / "other"), "--json"]) == 0
    printed = capfd.readouterr()
    assert printed.err.count("warning: ") == 2
    for name in ("one", "other"):
        assert f"warning: {tmp_path / name}: frame 6, camera CAM_BACK: frozen image" in printed.err
    assert len(json.loads(printed.out)["warnings"]) == 2


def test_t10_a_resumed_run_warns_about_the_frames_that_it_processes(tiny_bundle, scene, tmp_path):
    edit_scene(copy_tree(scene, tmp_path / "scene"), freeze("CAM_BACK"))
    first = jobs.run(tiny_bundle, tmp_path / "scene", tmp_path / "out")
    whole = contents(tmp_path / "out")
    lines = whole["results.jsonl"].splitlines(keepends=True)
    (tmp_path / "out" / "results.jsonl").write_bytes(b"".join(lines[:4]))
    resumed = jobs.run(tiny_bundle, tmp_path / "scene", tmp_path / "out", resume=True)
    assert resumed.warnings == first.warnings != ()
    assert contents(tmp_path / "out") == whole
