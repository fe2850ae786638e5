"""`run --overwrite`: row P10 of the reliability list. The earlier results stay until the new ones are complete."""

import json
import os
import random
import shutil
import signal
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from duospacenet.cli.main import run_app
from duospacenet.data.scene_writer import write_scene
from duospacenet.synthetic.drive import SyntheticDrive
from tests.helpers.output_files import add_user_files, assert_user_files_kept, contents
from tests.helpers.processes import call, start, start_until_import
from tests.helpers.scene_files import copy_tree, edit_scene, front_image
from tests.helpers.streams import TINY_SIZE_PX
from tests.reliability.test_full_disk import limit_files

DRIVE = "synthetic:5:3"
NUM_FRAMES = 8
BAD_FRAME = 6
NEW, FINISHED, MOVING = ".duospacenet-new", ".duospacenet-finished", ".duospacenet-moving"
NUM_KILLS = int(os.environ.get("DUOSPACENET_MOMENTS", "2"))  # `make reliability` sets more


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("scenes") / "scene"
    write_scene(folder, SyntheticDrive(8, frames=NUM_FRAMES, image_size=TINY_SIZE_PX))
    return folder


@pytest.fixture(scope="module")
def earlier(tiny_bundle, tmp_path_factory) -> dict[str, bytes]:
    """The files of an earlier run of another source, with more kinds of files."""
    out = tmp_path_factory.mktemp("earlier")
    options = ["--draw", "--maps", "--format", "nuscenes"]
    assert run_app(["run", str(tiny_bundle), DRIVE, "--out", str(out), *options]) == 0
    return contents(out)


@pytest.fixture(scope="module")
def new(tiny_bundle, scene, tmp_path_factory) -> dict[str, bytes]:
    """The files of the new run, in an empty folder."""
    out = tmp_path_factory.mktemp("new")
    assert run_app(["run", str(tiny_bundle), str(scene), "--out", str(out), "--maps"]) == 0
    return contents(out)


def write_files(folder: Path, files: dict[str, bytes]) -> Path:
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    return folder


def arguments(bundle: Path, source: Path, out: Path, option: str = "--overwrite") -> list[str]:
    return ["run", str(bundle), str(source), "--out", str(out), "--maps", option]


def bad_frame(record) -> dict:
    return record["frames"][BAD_FRAME]


def bad_camera(record) -> dict:
    """The front camera in the bad frame, with its own calibration."""
    camera = bad_frame(record)["cameras"]["CAM_FRONT"]
    camera |= {name: value for name, value in record["cameras"]["CAM_FRONT"].items() if camera.get(name) is None}
    return camera


def add_camera(record) -> None:
    record["cameras"]["CAM_SEVENTH"] = record["cameras"]["CAM_BACK"]


def invert_camera(record) -> None:
    bad_camera(record)["camera_T_ego"] = np.linalg.inv(bad_camera(record)["camera_T_ego"]).tolist()


BAD_SCENES: dict[str, tuple[Callable, str]] = {
    "a seventh camera": (add_camera, "cameras: expected 1 to 6"),
    "a mirrored pose": (lambda record: bad_frame(record)["global_T_ego"][0].reverse(), "global_T_ego"),
    "an earlier time": (lambda record: bad_frame(record).update(timestamp_s=0.0), "timestamp_s"),
    "another image size": (lambda record: bad_camera(record).update(width_px=164), "164x64 px"),
    "an inverted camera": (invert_camera, "CAM_FRONT"),
    "a path to a folder": (lambda record: bad_camera(record).update(image="images"), "expected a regular file"),
}


@pytest.mark.parametrize("kind", BAD_SCENES)
def test_p10_a_source_that_is_refused_keeps_the_earlier_results(tiny_bundle, scene, earlier, tmp_path, capfd, kind):
    change, words = BAD_SCENES[kind]
    copy_tree(scene, tmp_path / "scene")
    edit_scene(tmp_path / "scene", change)
    out = write_files(tmp_path / "out", earlier)
    assert run_app(arguments(tiny_bundle, tmp_path / "scene", out)) == 3
    assert words in (message := capfd.readouterr().err)
    assert message.count("\n") == 1
    assert contents(out) == earlier


def unlink(image: Path) -> None:
    image.unlink()


BAD_IMAGES = {
    "missing": unlink,
    "empty": lambda image: image.write_bytes(b""),
    "a text": lambda image: image.write_text("version https://git-lfs"),
    "of another size": lambda image: shutil.copy(front_image(image.parents[2] / "large", 0), image),
}


@pytest.mark.parametrize("kind", BAD_IMAGES)
def test_p10_an_image_file_that_is_refused_keeps_the_earlier_results(
    tiny_bundle, scene, earlier, tmp_path, capfd, kind
):
    copy_tree(scene, tmp_path / "scene")
    write_scene(tmp_path / "scene" / "large", SyntheticDrive(8, frames=1, image_size=(320, 128)))
    BAD_IMAGES[kind](front_image(tmp_path / "scene", BAD_FRAME))
    out = write_files(tmp_path / "out", earlier)
    assert run_app(arguments(tiny_bundle, tmp_path / "scene", out)) == 3
    assert f"frame {BAD_FRAME}: " in capfd.readouterr().err
    assert contents(out) == earlier


def test_p10_other_refusals_keep_the_earlier_results(tiny_bundle, scene, earlier, tmp_path, capfd):
    """A scene that cannot be read, an unknown policy, a lost camera that the policy refuses, a damaged bundle."""
    for name in ("cut", "lost"):
        copy_tree(scene, tmp_path / name)
    (tmp_path / "cut" / "scene.json").write_bytes((scene / "scene.json").read_bytes()[:-100])
    edit_scene(tmp_path / "lost", lambda record: bad_camera(record).update(image=None))
    copy_tree(tiny_bundle, tmp_path / "bundle")
    graph = tmp_path / "bundle" / "decoder.onnx"
    graph.write_bytes(graph.read_bytes()[:-1] + b"x")
    out = write_files(tmp_path / "out", earlier)
    for bundle, source, options, code, words in (
        (tiny_bundle, tmp_path / "cut", [], 3, "scene.json"),
        (tiny_bundle, tmp_path / "none", [], 3, "no such path"),
        (tiny_bundle, scene, ["--on-missing", "foo"], 2, "--on-missing: expected"),
        (tiny_bundle, tmp_path / "lost", ["--on-missing", "error"], 3, f"frame {BAD_FRAME}: camera CAM_FRONT"),
        (tiny_bundle, scene, ["--resume"], 2, "either --overwrite or --resume"),
        (tmp_path / "bundle", scene, [], 4, "decoder.onnx"),
    ):
        assert run_app([*arguments(bundle, source, out), *options]) == code
        assert words in capfd.readouterr().err
        assert contents(out) == earlier


def test_p10_the_new_results_replace_the_earlier_ones_completely(tiny_bundle, scene, earlier, new, tmp_path):
    """Pictures and a submission, which the new run does not write, are removed. Files of the user stay."""
    add_user_files(tmp_path)
    write_files(tmp_path, earlier)
    assert run_app(arguments(tiny_bundle, scene, tmp_path)) == 0
    assert_user_files_kept(tmp_path)
    mine = {"pictures/holiday.png", "notes.txt"}
    assert {name: content for name, content in contents(tmp_path).items() if name not in mine} == new
    assert sorted(path.name for path in tmp_path.iterdir() if path.is_dir()) == ["maps", "pictures"]


def test_p10_a_damaged_image_keeps_the_earlier_results_and_the_new_ones_are_resumed(
    tiny_bundle, scene, earlier, new, tmp_path, capfd
):
    """The damage is only found when the image is decoded. The same command with --resume continues there."""
    copy_tree(scene, tmp_path / "scene")
    image = front_image(tmp_path / "scene", BAD_FRAME)
    whole = image.read_bytes()
    image.write_bytes(whole[:-1000])
    out = write_files(tmp_path / "out", earlier)
    assert run_app(arguments(tiny_bundle, tmp_path / "scene", out)) == 3
    assert f"The earlier results in {out} are unchanged." in capfd.readouterr().err
    assert {name: content for name, content in contents(out).items() if not name.startswith(NEW)} == earlier
    assert (out / NEW / "results.jsonl").read_bytes().count(b"\n") == BAD_FRAME
    image.write_bytes(whole)
    assert run_app(arguments(tiny_bundle, tmp_path / "scene", out, "--resume")) == 0
    assert contents(out) == new


def test_p10_a_full_disk_keeps_the_earlier_results(tiny_bundle, scene, earlier, tmp_path):
    out = write_files(tmp_path / "out", earlier)
    for limit in (0, 20_000, 150_000):
        done = call(arguments(tiny_bundle, scene, out), preexec_fn=limit_files(limit))
        assert done.returncode == 5
        assert "File too large" in done.stderr
        assert {name: content for name, content in contents(out).items() if not name.startswith(NEW)} == earlier


def test_p10_an_interrupted_overwrite_leaves_a_choice(tiny_bundle, scene, earlier, new, tmp_path, capfd):
    """The unfinished run is resumed with its settings, the earlier one with its own, and others are refused."""
    lines = new["results.jsonl"].splitlines(keepends=True)
    unfinished = {f"{NEW}/run.json": new["run.json"], f"{NEW}/results.jsonl": b"".join(lines[:3])}
    unfinished |= {f"{NEW}/{name}": new[name] for name in new if name.startswith("maps/") and name < "maps/000003"}
    out = write_files(tmp_path / "out", earlier | unfinished)
    assert run_app(arguments(tiny_bundle, scene, out, "--draw")) == 5
    assert "an earlier run wrote this file" in capfd.readouterr().err
    assert run_app([*arguments(tiny_bundle, scene, out, "--resume"), "--draw"]) == 2
    assert f"{NEW}/run.json: the run began with draw False; got True" in capfd.readouterr().err
    assert contents(out) == earlier | unfinished
    shutil.copytree(out, tmp_path / "other")
    assert run_app(arguments(tiny_bundle, scene, out, "--resume")) == 0
    assert contents(out) == new
    options = ["--draw", "--maps", "--format", "nuscenes", "--resume"]
    assert run_app(["run", str(tiny_bundle), DRIVE, "--out", str(tmp_path / "other"), *options]) == 0
    assert contents(tmp_path / "other") == earlier | unfinished


@pytest.mark.parametrize("state", [FINISHED, MOVING])
def test_p10_a_killed_replacement_is_completed_by_the_next_run(tiny_bundle, scene, earlier, new, tmp_path, state):
    """FINISHED: before the first file was removed. MOVING: after some files were moved."""
    complete = {f"{state}/{name}": content for name, content in new.items()}
    if state == MOVING:
        complete.pop(f"{MOVING}/maps/000000_drivable_area.png")
        earlier = {name: new.get(name, content) for name, content in earlier.items() if name in new}
    out = write_files(tmp_path, earlier | complete)
    assert run_app(arguments(tiny_bundle, scene, out, "--resume")) == 0
    assert contents(out) == new


def test_p10_a_run_killed_at_random_moments_leaves_results_that_can_be_resumed(
    tiny_bundle, scene, earlier, new, tmp_path
):
    rng, kills, runs = random.Random(10), 0, 0
    while kills < NUM_KILLS:
        out, runs = write_files(tmp_path / str(runs), earlier), runs + 1
        process = start_until_import(arguments(tiny_bundle, scene, out), rng.randrange(300, 900))
        time.sleep(rng.random())
        process.send_signal(signal.SIGKILL)
        process.communicate(timeout=600)
        kills += process.returncode != 0
        assert (out / "results.jsonl").read_bytes() in (earlier["results.jsonl"], new["results.jsonl"])
        unfinished = out / NEW / "results.jsonl"
        if unfinished.exists():
            complete = unfinished.read_bytes().rpartition(b"\n")[0]
            assert new["results.jsonl"].startswith(complete)
        if not (out / NEW / "run.json").exists() and (out / "run.json").read_bytes() == earlier["run.json"]:
            assert {name: content for name, content in contents(out).items() if not name.startswith(NEW)} == earlier
            continue
        assert run_app(arguments(tiny_bundle, scene, out, "--resume")) == 0
        assert contents(out) == new


def test_p10_two_runs_do_not_replace_the_same_results(tiny_bundle, earlier, tmp_path, capfd):
    out = write_files(tmp_path, earlier)
    first = start(["run", tiny_bundle, "synthetic:6:400", "--out", out, "--overwrite"])
    results = out / NEW / "results.jsonl"
    while not results.exists() or not results.stat().st_size:
        time.sleep(0.05)
        assert first.poll() is None
    assert run_app(["run", str(tiny_bundle), DRIVE, "--out", str(out), "--overwrite"]) == 5
    assert "another run is writing there" in capfd.readouterr().err
    first.send_signal(signal.SIGINT)
    _, err = first.communicate(timeout=600)
    assert first.returncode == 130
    assert "add --resume to continue" in err
    assert {name: content for name, content in contents(out).items() if not name.startswith(NEW)} == earlier
    assert all(json.loads(line) for line in results.read_text().splitlines())


def test_p10_a_subfolder_that_cannot_be_written_is_refused_before_the_first_frame(
    tiny_bundle, scene, earlier, tmp_path, capfd
):
    """`pictures` is a link to a disk that is not mounted."""
    out = write_files(tmp_path, {name: content for name, content in earlier.items() if "pictures" not in name})
    (out / "pictures").symlink_to(tmp_path / "not mounted")
    before = contents(out)
    assert run_app(arguments(tiny_bundle, scene, out)) == 5
    assert "pictures" in capfd.readouterr().err
    assert contents(out) == before
