"""`duospacenet run` from end to end: its files, its output and its refusals."""

import json
import re

import cv2
import numpy as np
import pytest

from duospacenet.cli.main import run_app
from duospacenet.data.scene_writer import write_scene
from duospacenet.runtime import Pipeline
from duospacenet.synthetic.drive import SyntheticDrive
from tests.helpers.blocked_imports import call_without
from tests.helpers.bundles import edit_manifest
from tests.helpers.output_files import add_user_files, assert_user_files_kept
from tests.helpers.scene_files import copy_tree, edit_scene, front_image
from tests.helpers.streams import detect_all

DRIVE = "synthetic:5:3"


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """The drive as a scene folder. Tests that change it take a copy."""
    folder = tmp_path_factory.mktemp("scenes") / "scene"
    write_scene(folder, SyntheticDrive.parse(DRIVE))
    return folder


def test_run_writes_one_line_per_frame_and_only_the_summary_on_stdout(tiny_bundle, tmp_path, capfd):
    assert run_app(["run", str(tiny_bundle), DRIVE, "--out", str(tmp_path), "--json"]) == 0
    printed = capfd.readouterr()
    summary = json.loads(printed.out)
    assert summary["frames"] == 3
    assert set(summary["median_ms"]) == {"preprocess", "projector", "backbone", "lifter", "decoder", "postprocess"}
    lines = [json.loads(line) for line in (tmp_path / "results.jsonl").read_text().splitlines()]
    assert [line["history"]["frames"] for line in lines] == [1, 2, 3]
    assert [line["token"] for line in lines] == [frame.token for frame in SyntheticDrive.parse(DRIVE)]
    scores = [box["score"] for box in lines[0]["boxes"]]
    assert scores == sorted(scores, reverse=True)


def test_run_imports_only_what_a_scene_folder_needs(tiny_bundle, scene, tmp_path):
    unneeded = ["torch", "onnx", "openvino", "scipy", "matplotlib", "model_signing"]
    unneeded += [f"duospacenet.{package}" for package in ("synthetic", "evaluation", "weights", "model", "training")]
    done = call_without(unneeded, ["run", tiny_bundle, scene, "--out", tmp_path, "--json"])
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["frames"] == 3


def test_run_prints_the_median_times_and_the_counts(tiny_bundle, tmp_path, capfd):
    assert run_app(["run", str(tiny_bundle), "synthetic:5:1", "--out", str(tmp_path)]) == 0
    printed = capfd.readouterr().out
    assert re.search(r"backbone +│ +\d+\.\d", printed)
    assert re.search(r"^1 frames, \d+ boxes, peak memory \d\.\d GB; onnxruntime [\d.]+; results in ", printed, re.M)


def test_a_finished_run_is_resumed_without_an_empty_table(tiny_bundle, tmp_path, capfd):
    call = ["run", str(tiny_bundle), "synthetic:5:1", "--out", str(tmp_path)]
    assert run_app(call) == 0
    capfd.readouterr()
    assert run_app([*call, "--resume"]) == 0
    assert re.fullmatch(
        r"1 frames, \d+ boxes, peak memory \d\.\d GB; onnxruntime [\d.]+; results in .*\n", capfd.readouterr().out, re.S
    )


def test_run_renders_pictures_and_a_video(tiny_bundle, tmp_path):
    arguments = [
        "run",
        str(tiny_bundle),
        DRIVE,
        "--out",
        str(tmp_path),
        "--draw",
        "--video",
        "--maps",
        "--draw-ground-truth",
    ]
    assert run_app(arguments) == 0
    pictures = sorted((tmp_path / "pictures").iterdir())
    assert [path.name for path in pictures] == ["000000.png", "000001.png", "000002.png"]
    video = cv2.VideoCapture(str(tmp_path / "video.mp4"))
    assert video.get(cv2.CAP_PROP_FRAME_COUNT) == 3
    assert cv2.imread(str(pictures[0])).shape[:2] == (
        video.get(cv2.CAP_PROP_FRAME_HEIGHT),
        video.get(cv2.CAP_PROP_FRAME_WIDTH),
    )


def test_the_nuscenes_submission_holds_every_sample_in_the_global_frame(tiny_bundle, tmp_path):
    assert run_app(["run", str(tiny_bundle), DRIVE, "--out", str(tmp_path), "--format", "jsonl,nuscenes"]) == 0
    submission = json.loads((tmp_path / "results_nusc.json").read_text())
    lines = [json.loads(line) for line in (tmp_path / "results.jsonl").read_text().splitlines()]
    frames = list(SyntheticDrive.parse(DRIVE))
    assert list(submission["results"]) == [frame.token for frame in frames]
    box, submitted = lines[1]["boxes"][0], submission["results"][frames[1].token][0]
    expected = frames[1].global_T_ego @ [*box["center_m"], 1]
    assert submitted["translation"] == pytest.approx(expected[:3], abs=1e-3)
    w, x, y, z = submitted["rotation"]
    ego_yaw = np.arctan2(frames[1].global_T_ego[1, 0], frames[1].global_T_ego[0, 0])
    yaw_error = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)) - ego_yaw - box["yaw_rad"]
    assert np.cos(yaw_error) == pytest.approx(1, abs=1e-6)


def test_the_submission_is_as_small_as_asked_for(tiny_bundle, tmp_path):
    options = ["--submission-uses", "camera, map", "--submission-max-boxes", "7", "--submission-min-score", "0.001"]
    call = ["run", str(tiny_bundle), DRIVE, "--out", str(tmp_path), "--format", "nuscenes", *options]
    assert run_app(call) == 0
    submission = json.loads((tmp_path / "results_nusc.json").read_text())
    assert [name for name, used in submission["meta"].items() if used] == ["use_camera", "use_map"]
    assert {len(boxes) for boxes in submission["results"].values()} == {7}


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--submission-max-boxes", "7"], "options of the submission: expected --format nuscenes too"),
        (["--format", "nuscenes", "--submission-uses", "sonar"], "--submission-uses: expected some of camera, lidar"),
        (["--format", "nuscenes", "--submission-max-boxes", "501"], "less than or equal to 500"),
    ],
)
def test_wrong_options_of_the_submission_are_refused(tiny_bundle, tmp_path, options, words, capfd):
    assert run_app(["run", str(tiny_bundle), DRIVE, "--out", str(tmp_path / "out"), *options]) == 2
    assert words in capfd.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_scene_folder_gives_the_same_detections_as_its_synthetic_drive(tiny_bundle, scene, tmp_path):
    for source, out in ((DRIVE, "synthetic"), (str(scene), "folder")):
        assert run_app(["run", str(tiny_bundle), source, "--out", str(tmp_path / out)]) == 0
    synthetic, folder = (
        [json.loads(line)["boxes"] for line in (tmp_path / out / "results.jsonl").read_text().splitlines()]
        for out in ("synthetic", "folder")
    )
    assert synthetic == folder


def test_masks_are_written_beside_the_results(tiny_bundle, tmp_path):
    assert run_app(["run", str(tiny_bundle), DRIVE, "--out", str(tmp_path), "--maps"]) == 0
    lines = [json.loads(line) for line in (tmp_path / "results.jsonl").read_text().splitlines()]
    assert lines[2]["maps"] == {
        "drivable_area": "maps/000002_drivable_area.png",
        "lane_boundary": "maps/000002_lane_boundary.png",
    }
    detections = detect_all(Pipeline.load(tiny_bundle), SyntheticDrive.parse(DRIVE), maps=True)
    written = cv2.imread(str(tmp_path / lines[2]["maps"]["lane_boundary"]), cv2.IMREAD_GRAYSCALE)
    assert np.abs(written / 255 - detections[2].maps["lane_boundary"]).max() <= 0.5 / 255 + 1e-6


def test_run_keeps_the_users_files_in_the_output_folder(tiny_bundle, tmp_path):
    add_user_files(tmp_path)
    assert run_app(["run", str(tiny_bundle), DRIVE, "--overwrite", "--draw", "--out", str(tmp_path)]) == 0
    assert run_app(["run", str(tiny_bundle), DRIVE, "--overwrite", "--out", str(tmp_path)]) == 0
    assert_user_files_kept(tmp_path)
    assert not (tmp_path / "pictures" / "000000.png").exists()


def test_a_submission_with_a_repeated_token_is_refused(tiny_bundle, scene, tmp_path, capfd):
    copy_tree(scene, tmp_path / "scene")
    edit_scene(tmp_path / "scene", lambda scene: scene["frames"][2].update(token=scene["frames"][0]["token"]))
    arguments = ["run", str(tiny_bundle), str(tmp_path / "scene"), "--out", str(tmp_path), "--format", "nuscenes"]
    assert run_app(arguments) == 3
    assert "for the second time" in capfd.readouterr().err


@pytest.mark.parametrize("parity", [None, "failed"])
def test_a_bundle_without_a_passed_parity_report_does_not_run(tiny_bundle, tmp_path, capfd, parity):
    copy_tree(tiny_bundle, tmp_path / "bundle")
    report = None if parity is None else json.loads((tiny_bundle / "manifest.json").read_text())["parity"]
    edit_manifest(tmp_path / "bundle", lambda manifest: manifest.update(parity=report and report | {"passed": False}))
    assert run_app(["run", str(tmp_path / "bundle"), DRIVE, "--out", str(tmp_path / "out")]) == 4
    assert "field parity: expected a passed parity report" in capfd.readouterr().err
    assert run_app(["inspect", str(tmp_path / "bundle")]) == 0
    assert "not proven" in (shown := capfd.readouterr().out) or "not equal" in shown


def test_results_are_never_written_over_the_source(tiny_bundle, scene, tmp_path, capfd):
    copy_tree(scene, tmp_path / "scene")
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    assert run_app(["run", str(tiny_bundle), str(tmp_path / "scene"), "--out", str(tmp_path / "scene")]) == 2
    assert "--out: expected a folder other than the source's" in capfd.readouterr().err
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def test_frames_before_a_damaged_image_stay_on_disk(tiny_bundle, scene, tmp_path):
    """Only decoding finds the damage: the header of the image is right."""
    copy_tree(scene, tmp_path / "scene")
    image = front_image(tmp_path / "scene", frame=1)
    image.write_bytes(image.read_bytes()[:-5000])
    assert run_app(["run", str(tiny_bundle), str(tmp_path / "scene"), "--out", str(tmp_path)]) == 3
    lines = (tmp_path / "results.jsonl").read_text().splitlines()
    assert [json.loads(line)["history"]["frames"] for line in lines] == [1]


def test_an_image_file_that_cannot_be_right_is_refused_before_the_first_frame(tiny_bundle, scene, tmp_path, capfd):
    copy_tree(scene, tmp_path / "scene")
    front_image(tmp_path / "scene", frame=2).write_bytes(b"")
    assert run_app(["run", str(tiny_bundle), str(tmp_path / "scene"), "--out", str(tmp_path / "out")]) == 3
    assert re.search(
        r"error: frame 2: .*000002\.png: expected a JPEG or PNG image; got an empty file", capfd.readouterr().err
    )
    assert not (tmp_path / "out").exists()


def test_an_unknown_policy_is_refused_with_the_name_of_the_option(tiny_bundle, tmp_path, capfd):
    arguments = ["run", str(tiny_bundle), DRIVE, "--out", str(tmp_path / "out"), "--on-missing", "foo"]
    assert run_app(arguments) == 2
    assert "error: --on-missing: expected blank, skip or error; got 'foo'." in capfd.readouterr().err
    assert not (tmp_path / "out").exists()
