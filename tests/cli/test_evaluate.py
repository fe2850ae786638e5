"""`duospacenet eval` from end to end: its tables, its numbers and its exit codes."""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import onnxruntime
import pytest

from duospacenet.cli.main import run_app
from duospacenet.data.scene_writer import write_scene
from duospacenet.evaluation import Sample, evaluate
from duospacenet.evaluation.protocol import CLASSES
from duospacenet.synthetic.drive import SyntheticDrive
from duospacenet.weights import save_checkpoint
from tests.helpers.bundles import edit_manifest
from tests.helpers.streams import detect_all

DRIVES = ["synthetic:5:3", "synthetic:6:2"]


def scored(capfd, *arguments: str) -> dict:
    """The JSON of an evaluation that ends well."""
    capfd.readouterr()
    assert run_app(["eval", *arguments, "--json"]) == 0
    return json.loads(capfd.readouterr().out)


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> Path:
    """The first drive as a scene folder, with masks on the grid of the tiny bundle."""
    folder = tmp_path_factory.mktemp("scenes") / "scene"
    write_scene(folder, SyntheticDrive(5, frames=3, grid=(16, 16)))
    return folder


def test_the_tables_hold_every_class_and_are_followed_by_means_and_notes(tiny_bundle, capfd):
    assert run_app(["eval", str(tiny_bundle), *DRIVES]) == 0
    printed = capfd.readouterr()
    lines = printed.out.splitlines()
    assert max(map(len, lines[1:26])) <= 80  # the first line holds the path of the bundle
    for name in CLASSES:
        assert len([line for line in lines if line.split()[:1] == [name]]) == 2
    for words in ("AP@0.5   AP@1   AP@2   AP@4     AP", "ATE [m]    ASE  AOE [rad]  AVE [m/s]    AAE"):
        assert words in printed.out
    assert re.search(r"^mAP 0\.\d{3}  mATE .* mASE .* mAOE .* mAVE .* mAAE .* NDS 0\.\d{3}$", printed.out, re.M)
    assert re.search(r"^IoU of lane_boundary: 0\.\d{3}$", printed.out, re.M)
    assert "judged: boxes in 5 frames, drivable_area in 5 frames, lane_boundary in 5 frames" in printed.out
    assert "true attributes are derived from true speeds" in printed.out
    assert "eval" in printed.err


def test_the_numbers_compare_the_bundles_stream_with_the_ground_truth(tiny_bundle, pipeline, capfd):
    drives = [SyntheticDrive(5, frames=3, grid=(16, 16)), SyntheticDrive(6, frames=2, grid=(16, 16))]
    pairs = [(detect_all(pipeline, frames, maps=True), frames) for frames in drives]
    expected = evaluate(
        Sample.of_detections(found, frame.ground_truth, frame.global_T_ego)
        for answers, frames in pairs
        for found, frame in zip(answers, frames, strict=True)
    )
    got = scored(capfd, str(tiny_bundle), *DRIVES)
    engine = {"name": "onnxruntime", "version": onnxruntime.__version__, "precision": "float32"}
    facts = {"bundle": str(tiny_bundle), "sources": DRIVES, "eager": False, "single_frame": False, "warnings": []}
    facts |= {"engine": engine, "fast_decoding": False, "history_step_s": None}
    assert got == facts | expected.to_dict()
    assert got["samples"] == 5
    assert set(got["map_iou"]) == {"drivable_area", "lane_boundary"}
    assert sum(one["detections"] for one in got["classes"].values()) > 500


def test_a_scene_folder_gives_the_same_scores_as_its_synthetic_drive(tiny_bundle, scene, capfd):
    folder, synthetic = (scored(capfd, str(tiny_bundle), source) for source in (str(scene), DRIVES[0]))
    del folder["sources"], synthetic["sources"]
    assert folder == synthetic


def test_the_model_in_eager_mode_gives_the_same_scores_as_its_bundle(tiny_bundle, tiny_model, tmp_path, capfd):
    """tests/export/parity/test_eager_stream.py compares them frame by frame."""
    save_checkpoint(tmp_path / "tiny.safetensors", tiny_model)
    weights = ["--eager", "--weights", str(tmp_path / "tiny.safetensors")]
    onnx, eager = (scored(capfd, str(tiny_bundle), DRIVES[1], *options) for options in ([], weights))
    assert (onnx.pop("eager"), eager.pop("eager")) == (False, True)
    assert (onnx.pop("engine")["name"], eager.pop("engine")) == ("onnxruntime", None)
    assert flat(eager) == pytest.approx(flat(onnx), abs=1e-3)
    assert eager["samples"] == 2


def test_single_frame_evaluates_every_frame_as_a_cold_start(tiny_bundle, pipeline, capfd):
    frames = list(SyntheticDrive(5, frames=6, grid=(16, 16)))
    cold = evaluate(
        Sample.of_detections(detect_all(pipeline, [frame], maps=True)[0], frame.ground_truth, frame.global_T_ego)
        for frame in frames
    ).to_dict()
    alone, streamed = (
        scored(capfd, str(tiny_bundle), "synthetic:5:6", *options) for options in (["--single-frame"], [])
    )
    assert (alone["single_frame"], streamed["single_frame"]) == (True, False)
    assert {key: alone[key] for key in cold} == cold
    assert {key: streamed[key] for key in cold} != cold


def test_frames_without_known_boxes_are_not_evaluated(tiny_bundle, scene, capfd):
    source = copied(scene, scene.parent / "half", lambda frames: frames[1].pop("boxes"))
    assert scored(capfd, str(tiny_bundle), str(source))["samples"] == 2


def test_a_source_without_true_boxes_and_masks_is_refused(tiny_bundle, scene, capfd):
    unknown = ("boxes", "maps")
    source = copied(scene, scene.parent / "blind", lambda frames: [frame.pop(k) for k in unknown for frame in frames])
    assert run_app(["eval", str(tiny_bundle), DRIVES[0], str(source)]) == 3
    assert f"{source}: expected true boxes or masks to compare with" in capfd.readouterr().err


def test_a_bundle_with_other_classes_is_refused(tiny_bundle, tmp_path, capfd):
    def rename(manifest: dict) -> None:
        manifest["classes"][0] = "tram"

    bundle = edit_manifest(shutil.copytree(tiny_bundle, tmp_path / "bundle"), rename)
    assert run_app(["eval", str(bundle), DRIVES[0]]) == 4
    assert "field classes: expected classes of nuScenes' benchmark" in capfd.readouterr().err


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--eager"], "--eager: expected --weights FILE"),
        (["--weights", "w.pth"], "expected only with --eager"),
        (["--eager", "--weights", "w.pth", "--threads", "1"], "--threads: expected only without --eager"),
    ],
)
def test_options_that_contradict_each_other_are_refused(tiny_bundle, options, words, capfd):
    assert run_app(["eval", str(tiny_bundle), DRIVES[0], *options]) == 2
    assert words in capfd.readouterr().err


@pytest.fixture(scope="module")
def submission(tiny_bundle, scene, tmp_path_factory) -> Path:
    """The submission of the tiny bundle on the scene folder."""
    out = tmp_path_factory.mktemp("runs") / "run"
    assert run_app(["run", str(tiny_bundle), str(scene), "--out", str(out), "--format", "nuscenes"]) == 0
    return out / "results_nusc.json"


def test_a_submission_gets_the_scores_of_the_bundle_that_wrote_it(tiny_bundle, scene, submission, capfd):
    bundle = scored(capfd, str(tiny_bundle), str(scene))
    got = scored(capfd, "--results", str(submission), str(scene))
    assert {key: got[key] for key in ("mAP", "NDS", "errors", "classes", "ground_truth")} == {
        key: bundle[key] for key in ("mAP", "NDS", "errors", "classes", "ground_truth")
    }
    assert got["submission"] == str(submission)
    assert got["meta"]["use_camera"] is True


def test_the_tables_name_the_submission_or_the_bundle_and_its_engine(tiny_bundle, scene, submission, capfd):
    capfd.readouterr()
    assert run_app(["eval", "--results", str(submission), str(scene)]) == 0
    printed = capfd.readouterr().out
    assert printed.startswith(f"submission {submission}; its meta says that it uses camera\n")
    assert "IoU of" not in printed
    assert run_app(["eval", str(tiny_bundle), str(scene)]) == 0
    assert capfd.readouterr().out.startswith(f"bundle {tiny_bundle}; onnxruntime {onnxruntime.__version__}, float32\n")


def test_a_submission_that_is_not_for_the_source_ends_with_exit_code_3(submission, capfd):
    assert run_app(["eval", "--results", str(submission), DRIVES[1]]) == 3
    assert "expected only sample tokens of the sources; got" in capfd.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["only_a_bundle"], "expected a bundle and at least one source, or --results FILE and sources; got 'only_a_"),
        (
            ["--results", "r.json", DRIVES[0], "--single-frame"],
            "--single-frame: expected only with a bundle",
        ),
        (["--results", "r.json", DRIVES[0], "--limit", "3"], "--limit: expected only with a bundle"),
        (["--results", "r.json", DRIVES[0], "--no-check"], "--no-check: expected only with a bundle"),
        (["--results", "r.json", DRIVES[0], "--engine", "openvino"], "--engine: expected only with a bundle"),
    ],
)
def test_wrong_combinations_of_a_bundle_and_a_submission_are_refused(arguments, words, capfd):
    assert run_app(["eval", *arguments]) == 2
    assert words in capfd.readouterr().err


def test_a_submission_is_evaluated_without_onnxruntime_and_torch(scene, submission):
    missing = ("torch", "onnx", "onnxruntime", "openvino", "matplotlib")
    block = f"import sys; sys.modules.update(dict.fromkeys({missing})); from duospacenet.cli.main import main; main()"
    call = [sys.executable, "-c", block, "eval", "--results", str(submission), str(scene), "--json"]
    done = subprocess.run(call, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "eval ...\n")
    assert json.loads(done.stdout)["samples"] == 3


def test_plots_are_written_to_a_new_folder(tiny_bundle, tmp_path, capfd):
    call = ["eval", str(tiny_bundle), "synthetic:5:1", "--plots", str(tmp_path / "plots"), "--json"]
    assert run_app(call) == 0
    assert sorted(path.name for path in (tmp_path / "plots").iterdir()) == ["errors.png", "precision.png"]
    capfd.readouterr()
    assert run_app(call) == 5
    printed = capfd.readouterr()
    assert "exists already" in printed.err
    assert printed.out == ""  # it was refused before the evaluation


def test_an_interrupted_evaluation_ends_with_130_and_writes_nothing(tiny_bundle, tmp_path, monkeypatch, capfd):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("duospacenet.synthetic.drive.SyntheticDrive.frame", interrupt)
    assert run_app(["eval", str(tiny_bundle), DRIVES[0], "--plots", str(tmp_path / "plots")]) == 130
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr().out == ""


def test_only_plots_need_matplotlib_and_eval_does_not_need_torch(tiny_bundle, tmp_path):
    missing = ("torch", "onnx", "onnxscript", "safetensors", "matplotlib")
    block = f"import sys; sys.modules.update(dict.fromkeys({missing})); from duospacenet.cli.main import main; main()"
    call = [sys.executable, "-c", block, "eval", str(tiny_bundle), "synthetic:5:1"]
    done = subprocess.run([*call, "--plots", str(tmp_path / "p")], capture_output=True, text=True, check=False)
    assert done.returncode == 6
    assert "pip install 'duospacenet[viz]'" in done.stderr
    done = subprocess.run([*call, "--json"], capture_output=True, text=True, check=False)
    assert (done.returncode, json.loads(done.stdout)["samples"]) == (0, 1)


def flat(value: dict, name: str = "") -> dict[str, float | None]:
    """The numbers of nested dictionaries by their path."""
    numbers: dict[str, float | None] = {}
    for key, item in value.items():
        if isinstance(item, dict):
            numbers |= flat(item, f"{name}.{key}")
        elif item is None or isinstance(item, (int, float)):
            numbers[f"{name}.{key}"] = -1 if item is None else item
    return numbers


def copied(scene: Path, target: Path, change) -> Path:
    """A copy of a scene folder with changed frames."""
    shutil.copytree(scene, target)
    content = json.loads((target / "scene.json").read_text())
    change(content["frames"])
    (target / "scene.json").write_text(json.dumps(content))
    return target
