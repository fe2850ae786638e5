"""The command line from end to end: what it prints where, what it writes, and how it ends."""

import json
import re
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from duospacenet.cli import demo as cli_demo
from duospacenet.cli.main import run_app
from duospacenet.data.scene_writer import write_scene
from duospacenet.runtime import Pipeline
from duospacenet.runtime.bundle.manifest import read_manifest
from duospacenet.synthetic.drive import SyntheticDrive
from duospacenet.weights import save_checkpoint
from tests.helpers.bundles import edit_manifest
from tests.helpers.streams import detect_all

DRIVE = "synthetic:5:3"


@pytest.fixture(scope="module")
def checkpoint(tiny_model, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("weights") / "tiny.safetensors"
    save_checkpoint(path, tiny_model)
    return path


@pytest.fixture(scope="module")
def exported(checkpoint, tmp_path_factory) -> Path:
    """A bundle that the command line made from a checkpoint."""
    out = tmp_path_factory.mktemp("exported") / "bundle"
    assert run_app(["export", "--preset", "tiny", "--weights", str(checkpoint), "--out", str(out)]) == 0
    return out


def test_a_checkpoint_is_exported_with_its_provenance(exported, tiny_bundle, checkpoint):
    manifest = json.loads((exported / "manifest.json").read_text())
    assert manifest["weights"]["source"] == "tiny.safetensors"
    assert manifest["weights"]["file_sha256"] == sha256sum(checkpoint)
    assert manifest["weights"]["sha256"] == json.loads((tiny_bundle / "manifest.json").read_text())["weights"]["sha256"]
    assert manifest["weights"]["trained"] is None
    assert manifest["parity"]["passed"] is True


def test_the_same_weights_give_the_same_bytes_in_two_exports(exported, tiny_bundle):
    """One of them from a model in memory, the other from its checkpoint: only that differs."""
    for graph in ("projector", "backbone", "lifter", "decoder", "segmenter"):
        assert (exported / f"{graph}.onnx").read_bytes() == (tiny_bundle / f"{graph}.onnx").read_bytes()
    one, other = (json.loads((bundle / "manifest.json").read_text()) for bundle in (exported, tiny_bundle))
    differing = {"weights": None, "sha256": None}
    assert one | differing == other | differing


def test_run_writes_a_line_a_frame_and_says_so_on_stdout_alone(tiny_bundle, tmp_path, capfd):
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


def test_run_draws_pictures_and_a_video(tiny_bundle, tmp_path):
    arguments = ["run", str(tiny_bundle), DRIVE, "--out", str(tmp_path), "--draw", "--video", "--maps", "--draw-truth"]
    assert run_app(arguments) == 0
    pictures = sorted((tmp_path / "pictures").iterdir())
    assert [path.name for path in pictures] == ["000000.png", "000001.png", "000002.png"]
    video = cv2.VideoCapture(str(tmp_path / "video.mp4"))
    assert video.get(cv2.CAP_PROP_FRAME_COUNT) == 3
    assert cv2.imread(str(pictures[0])).shape[:2] == (
        video.get(cv2.CAP_PROP_FRAME_HEIGHT),
        video.get(cv2.CAP_PROP_FRAME_WIDTH),
    )


def test_the_nuscenes_submission_has_every_sample_and_lies_in_the_global_frame(tiny_bundle, tmp_path):
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
    turned = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)) - ego_yaw - box["yaw_rad"]
    assert np.cos(turned) == pytest.approx(1, abs=1e-6)


def test_parity_ends_with_1_where_the_weights_are_others(tiny_bundle, capfd):
    source = ["--source", "synthetic:3:2", "--json"]
    assert run_app(["parity", str(tiny_bundle), "--random-weights", "--seed", "0", *source]) == 0
    assert json.loads(capfd.readouterr().out)["passed"] is True
    assert run_app(["parity", str(tiny_bundle), "--random-weights", "--seed", "1", *source]) == 1
    printed = capfd.readouterr()
    assert json.loads(printed.out)["passed"] is False
    assert "the bundle was made from other weights" in printed.err


def test_parity_and_inspect_print_what_was_measured(tiny_bundle, capfd):
    assert run_app(["inspect", str(tiny_bundle)]) == 0
    shown = capfd.readouterr().out
    for word in ("tiny", "backbone.onnx", "image_T_ego", "slot3.bev_value_1", "relative to RMS", "equal"):
        assert word in shown
    assert run_app(["inspect", str(tiny_bundle), "--json"]) == 0
    assert json.loads(capfd.readouterr().out) == json.loads((tiny_bundle / "manifest.json").read_text())


def test_a_scene_folder_gives_what_the_drive_itself_gives(tiny_bundle, tmp_path):
    write_scene(tmp_path / "scene", SyntheticDrive.parse(DRIVE))
    for source, out in ((DRIVE, "drawn"), (str(tmp_path / "scene"), "read")):
        assert run_app(["run", str(tiny_bundle), source, "--out", str(tmp_path / out)]) == 0
    drawn, read = (
        [json.loads(line)["boxes"] for line in (tmp_path / out / "results.jsonl").read_text().splitlines()]
        for out in ("drawn", "read")
    )
    assert drawn == read


def test_masks_are_written_beside_the_results(tiny_bundle, tmp_path):
    assert run_app(["run", str(tiny_bundle), DRIVE, "--out", str(tmp_path), "--maps"]) == 0
    lines = [json.loads(line) for line in (tmp_path / "results.jsonl").read_text().splitlines()]
    assert lines[2]["maps"] == {
        "drivable_area": "maps/000002_drivable_area.png",
        "lane_boundary": "maps/000002_lane_boundary.png",
    }
    answers = detect_all(Pipeline.load(tiny_bundle), SyntheticDrive.parse(DRIVE), maps=True)
    written = cv2.imread(str(tmp_path / lines[2]["maps"]["lane_boundary"]), cv2.IMREAD_GRAYSCALE)
    assert np.abs(written / 255 - answers[2].maps["lane_boundary"]).max() <= 0.5 / 255 + 1e-6


def test_what_others_keep_in_the_folder_stays(tiny_bundle, tmp_path):
    keep_something(tmp_path)
    assert run_app(["run", str(tiny_bundle), DRIVE, "--overwrite", "--draw", "--out", str(tmp_path)]) == 0
    assert run_app(["run", str(tiny_bundle), DRIVE, "--overwrite", "--out", str(tmp_path)]) == 0
    assert_kept(tmp_path)
    assert not (tmp_path / "pictures" / "000000.png").exists()


def test_a_demo_proves_runs_draws_and_judges_and_a_second_one_proves_again(
    traced_already, tiny_model, tmp_path, monkeypatch, capfd
):
    monkeypatch.setattr(cli_demo, "PRESET", "tiny")
    monkeypatch.setattr(cli_demo, "SOURCE", "synthetic:7:8")
    monkeypatch.setattr(cli_demo, "PICTURE", 5)
    checkpoint = tmp_path.parent / f"{tmp_path.name}.safetensors"
    save_checkpoint(checkpoint, tiny_model, {"trained": "false"})
    monkeypatch.setattr(cli_demo, "shipped_weights", lambda preset: checkpoint)
    keep_something(tmp_path)
    answers = []
    for _ in range(2):
        assert run_app(["demo", "--out", str(tmp_path)]) == 0
        printed = capfd.readouterr().out
        assert "equal to eager mode" in printed
        assert "NDS" in printed
        assert str(tmp_path / "pictures" / "000005.png") in printed
        answers.append((tmp_path / "results.jsonl").read_text().splitlines())
    assert answers[0] == answers[1]
    assert len(list((tmp_path / "pictures").glob("0*.png"))) == len(answers[0]) == 8
    assert (tmp_path / "video.mp4").stat().st_size > 0
    assert_kept(tmp_path)


@pytest.mark.parametrize(
    ("is_ours", "weights_are_new", "expected"),
    [(True, True, "export"), (True, False, "parity"), (False, True, "parity")],
)
def test_a_demo_makes_its_own_bundle_again_where_other_weights_ship_by_now(
    tiny_bundle, tmp_path, monkeypatch, capfd, is_ours, weights_are_new, expected
):
    """Somebody else's bundle stays, and is compared."""
    bundle, done = tmp_path / "bundle", []
    copy_tree(tiny_bundle, bundle)
    (bundle / "old").touch()
    if is_ours:
        (tmp_path / "run.json").write_text(json.dumps({"demo": "synthetic:7:2"}))
    made_from = read_manifest(bundle).weights.file_sha256
    monkeypatch.setattr(cli_demo, "SOURCE", "synthetic:7:2")
    monkeypatch.setattr(cli_demo, "sha256", lambda path: "new" if weights_are_new else made_from)
    monkeypatch.setattr(cli_demo, "parity", lambda bundle, weights: done.append("parity"))
    monkeypatch.setattr(
        cli_demo, "export", lambda preset, out, weights: (copy_tree(tiny_bundle, out), done.append("export"))
    )
    assert run_app(["demo", "--out", str(tmp_path)]) == 0
    assert done == [expected]
    assert (bundle / "old").exists() == (expected == "parity")
    assert ("made again" in capfd.readouterr().err) == (expected == "export")


def test_a_token_given_twice_is_refused_in_a_submission(tiny_bundle, tmp_path, capfd):
    write_scene(tmp_path / "scene", SyntheticDrive.parse(DRIVE))
    edit_scene(tmp_path / "scene", lambda scene: scene["frames"][2].update(token=scene["frames"][0]["token"]))
    arguments = ["run", str(tiny_bundle), str(tmp_path / "scene"), "--out", str(tmp_path), "--format", "nuscenes"]
    assert run_app(arguments) == 3
    assert "for the second time" in capfd.readouterr().err


@pytest.mark.parametrize("parity", [None, "failed"])
def test_a_bundle_without_a_passed_proof_does_not_run(tiny_bundle, tmp_path, capfd, parity):
    copy_tree(tiny_bundle, tmp_path / "bundle")
    proof = None if parity is None else json.loads((tiny_bundle / "manifest.json").read_text())["parity"]
    edit_manifest(tmp_path / "bundle", lambda manifest: manifest.update(parity=proof and proof | {"passed": False}))
    assert run_app(["run", str(tmp_path / "bundle"), DRIVE, "--out", str(tmp_path / "out")]) == 4
    assert "field parity: expected a passed parity report" in capfd.readouterr().err
    assert run_app(["inspect", str(tmp_path / "bundle")]) == 0
    assert "not proven" in (shown := capfd.readouterr().out) or "not equal" in shown


CONFIG_DAMAGE = {
    "another kind of block": (lambda config: config["backbone"].update(block="wide"), "field config"),
    "no heads": (lambda config: config.update(num_heads=0), "field config"),
    "a word for a number": (lambda config: config.update(channels="many"), "field config"),
    "fewer queries": (lambda config: config.update(num_queries=16), "mis-shaped|other tensors"),
    "more layers": (lambda config: config.update(num_layers=3), "other tensors"),
}


@pytest.mark.parametrize("damage", CONFIG_DAMAGE)
def test_a_configuration_that_is_not_the_bundles_is_refused(tiny_bundle, tmp_path, capfd, damage):
    change, words = CONFIG_DAMAGE[damage]
    copy_tree(tiny_bundle, tmp_path / "bundle")
    edit_manifest(tmp_path / "bundle", lambda manifest: change(manifest["config"]))
    assert run_app(["parity", str(tmp_path / "bundle"), "--random-weights"]) == 4
    assert re.search(words, capfd.readouterr().err)


BAD_CALLS = {
    "no such command": (["fly"], 2, "No such command"),
    "unknown option": (["inspect", "{bundle}", "--fast"], 2, "No such option"),
    "unknown preset": (["export", "--preset", "huge", "--random-weights", "--out", "{out}"], 2, "one of tiny, "),
    "no weights": (["export", "--preset", "tiny", "--out", "{out}"], 2, "either --weights FILE or --random-weights"),
    "both weights": (
        ["export", "--preset", "tiny", "--random-weights", "--weights", "{checkpoint}", "--out", "{out}"],
        2,
        "got both or neither",
    ),
    "unknown format": (["run", "{bundle}", DRIVE, "--out", "{out}", "--format", "xml"], 2, "expected jsonl or"),
    "missing checkpoint": (
        ["export", "--preset", "tiny", "--weights", "{tmp}/none.safetensors", "--out", "{out}"],
        4,
        "expected a checkpoint, .safetensors or .pth; got no such file",
    ),
    "truncated checkpoint": (
        ["export", "--preset", "tiny", "--weights", "{tmp}/cut.safetensors", "--out", "{out}"],
        4,
        "truncated, damaged, or of another kind",
    ),
    "another preset's checkpoint": (
        ["export", "--preset", "nano", "--weights", "{checkpoint}", "--out", "{out}"],
        4,
        "mis-shaped",
    ),
    "missing bundle": (["run", "{tmp}/none", DRIVE, "--out", "{out}"], 4, "expected a bundle folder"),
    "tampered graph": (
        ["run", "{tmp}/tampered", DRIVE, "--out", "{out}"],
        4,
        "decoder.onnx: field graphs.decoder.sha",
    ),
    "missing scene": (["run", "{bundle}", "{tmp}/none", "--out", "{out}"], 3, "none"),
    "bad drive": (["run", "{bundle}", "synthetic:x", "--out", "{out}"], 3, "synthetic:x"),
    "unreadable image": (["run", "{bundle}", "{tmp}/garbled", "--out", "{out}"], 3, "CAM_FRONT"),
    "wrong size": (["run", "{bundle}", "{tmp}/resized", "--out", "{out}"], 3, "CAM_FRONT"),
    "NaN in a matrix": (["run", "{bundle}", "{tmp}/nan", "--out", "{out}"], 3, "intrinsics_px"),
    "unknown camera": (["run", "{bundle}", "{tmp}/unknown", "--out", "{out}"], 3, "CAM_ROOF"),
    "older time stamp": (["run", "{bundle}", "{tmp}/older", "--out", "{out}"], 3, "timestamp_s"),
    "existing bundle": (
        ["export", "--preset", "tiny", "--random-weights", "--out", "{bundle}"],
        5,
        "it exists already",
    ),
    "unwritable out": (["run", "{bundle}", DRIVE, "--out", "/proc/none/out"], 5, "cannot be written"),
}


@pytest.fixture(scope="module")
def broken(tiny_bundle, checkpoint, tmp_path_factory) -> dict[str, Path]:
    """A folder of broken things, and the sound ones beside it, by the names that BAD_CALLS use."""
    tmp = tmp_path_factory.mktemp("broken")
    (tmp / "cut.safetensors").write_bytes(checkpoint.read_bytes()[:5000])
    copy_tree(tiny_bundle, tmp / "tampered")
    decoder = bytearray((tmp / "tampered" / "decoder.onnx").read_bytes())
    decoder[len(decoder) // 2] ^= 1
    (tmp / "tampered" / "decoder.onnx").write_bytes(decoder)
    write_scene(tmp / "sound", SyntheticDrive.parse(DRIVE))
    for name in ("garbled", "resized", "nan", "unknown", "older"):
        copy_tree(tmp / "sound", tmp / name)
    front = front_image(tmp / "garbled")
    front.write_bytes(front.read_bytes()[:200])
    cv2.imwrite(str(front_image(tmp / "resized")), np.zeros((10, 10, 3), np.uint8))
    edit_scene(tmp / "nan", lambda scene: set_intrinsic(scene, float("nan")))
    edit_scene(tmp / "unknown", lambda scene: scene["frames"][0]["cameras"].update(CAM_ROOF={"image": None}))
    edit_scene(tmp / "older", lambda scene: scene["frames"][1].update(timestamp_s=scene["frames"][0]["timestamp_s"]))
    return {"tmp": tmp, "bundle": tiny_bundle, "checkpoint": checkpoint}


@pytest.mark.parametrize("call", BAD_CALLS)
def test_a_bad_call_ends_with_a_message_and_its_exit_code(broken, call, tmp_path, capfd):
    arguments, code, words = BAD_CALLS[call]
    assert run_app([argument.format(**broken, out=tmp_path / "out") for argument in arguments]) == code
    printed = capfd.readouterr()
    assert words in printed.err
    assert "Traceback" not in printed.err
    assert "internal error" not in printed.err
    assert printed.out == ""
    assert not (tmp_path / "out" / "manifest.json").exists()


def test_results_are_never_written_over_the_source(broken, tmp_path, capfd):
    copy_tree(broken["tmp"] / "sound", tmp_path / "scene")
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    assert run_app(["run", str(broken["bundle"]), str(tmp_path / "scene"), "--out", str(tmp_path / "scene")]) == 2
    assert "--out: expected another folder than the source's" in capfd.readouterr().err
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def test_frames_before_a_bad_one_are_on_disk(broken, tmp_path):
    copy_tree(broken["tmp"] / "sound", tmp_path / "scene")
    front_image(tmp_path / "scene", frame=1).write_bytes(b"")
    assert run_app(["run", str(broken["bundle"]), str(tmp_path / "scene"), "--out", str(tmp_path)]) == 3
    lines = (tmp_path / "results.jsonl").read_text().splitlines()
    assert [json.loads(line)["history"]["frames"] for line in lines] == [1]


@pytest.mark.parametrize(
    "command", [[], ["export"], ["run"], ["parity"], ["inspect"], ["check-rig"], ["demo"], ["eval"], ["train"]]
)
def test_help_is_there(command, capfd):
    assert run_app([*command, "--help"]) == 0
    assert "Usage: duospacenet" in capfd.readouterr().out


def test_a_missing_extra_is_named(tiny_bundle, tmp_path):
    """In a process in which torch cannot be imported."""
    missing = ("torch", "onnx", "onnx_ir", "onnxscript", "safetensors")
    block = f"import sys; sys.modules.update(dict.fromkeys({missing})); from duospacenet.cli.main import main; main()"
    call = [sys.executable, "-c", block, "export", "--preset", "tiny", "--random-weights", "--out", str(tmp_path / "b")]
    done = subprocess.run(call, capture_output=True, text=True, check=False)
    assert done.returncode == 6
    assert "pip install 'duospacenet[export]'" in done.stderr
    run = [sys.executable, "-c", block, "run", str(tiny_bundle), DRIVE, "--out", str(tmp_path / "o"), "--draw"]
    assert subprocess.run(run, capture_output=True, text=True, check=False).returncode == 0


def keep_something(folder: Path) -> None:
    (folder / "pictures").mkdir()
    (folder / "pictures" / "holiday.png").write_bytes(b"sun")
    (folder / "notes.txt").write_text("mine")


def assert_kept(folder: Path) -> None:
    assert (folder / "pictures" / "holiday.png").read_bytes() == b"sun"
    assert (folder / "notes.txt").read_text() == "mine"


def sha256sum(path: Path) -> str:
    return subprocess.run(["sha256sum", path], capture_output=True, text=True, check=True).stdout.split()[0]


def copy_tree(source: Path, target: Path) -> None:
    subprocess.run(["cp", "-r", source, target], check=True)


def front_image(scene: Path, frame: int = 0) -> Path:
    record = json.loads((scene / "scene.json").read_text())["frames"][frame]
    return scene / record["cameras"]["CAM_FRONT"]["image"]


def edit_scene(folder: Path, edit) -> None:
    scene = json.loads((folder / "scene.json").read_text())
    edit(scene)
    (folder / "scene.json").write_text(json.dumps(scene))


def set_intrinsic(scene: dict, value: float) -> None:
    cameras = scene.get("cameras") or scene["frames"][0]["cameras"]
    cameras["CAM_FRONT"]["intrinsics_px"][0][0] = value
