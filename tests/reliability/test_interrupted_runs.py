"""Interrupted and resumed runs: row P2 of the reliability list."""

import json
import os
import random
import signal
import time
from pathlib import Path

import pytest

from duospacenet.cli.main import run_app
from duospacenet.data.results import drop_partial_line, read_results
from duospacenet.data.scene_writer import write_scene
from duospacenet.synthetic.drive import SyntheticDrive
from tests.helpers.output_files import contents
from tests.helpers.processes import start, start_until_import, wait_for
from tests.helpers.streams import TINY_SIZE_PX, lose_cameras

DRIVE = "synthetic:5:3"
NUM_FRAMES = 24
NUM_INTERRUPTIONS = int(os.environ.get("DUOSPACENET_MOMENTS", "3"))  # `make reliability` sets more


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> Path:
    """Frames of the network's own input size, which keeps preprocessing short; some with lost cameras."""
    frames = list(SyntheticDrive(8, frames=NUM_FRAMES, image_size=TINY_SIZE_PX))
    for index in (4, 5, 12):
        frames[index] = lose_cameras(frames[index], "CAM_FRONT")
    frames[18] = lose_cameras(frames[18], *frames[18].cameras)
    folder = tmp_path_factory.mktemp("scenes") / "scene"
    write_scene(folder, frames)
    return folder


def test_p2_an_interrupted_run_ends_with_130_and_leaves_complete_lines(tiny_bundle, tmp_path):
    for signal_number in (signal.SIGINT, signal.SIGTERM):
        out = tmp_path / str(signal_number)
        process = start(["run", tiny_bundle, "synthetic:1:2000", "--out", out, "--video"])
        results = out / "results.jsonl"
        wait_for(lambda results=results: count_lines(results) >= 3, timeout_s=600)
        process.send_signal(signal_number)
        _, err = process.communicate(timeout=600)
        assert process.returncode == 130
        assert "interrupted" in err
        assert "Traceback" not in err
        assert all(json.loads(line) for line in results.read_text().splitlines())
        assert sorted(path.name for path in out.iterdir()) == ["results.jsonl", "run.json"]


@pytest.fixture(scope="module")
def uninterrupted(tiny_bundle, scene, tmp_path_factory) -> dict[str, bytes]:
    """The files of a run that is not interrupted."""
    out = tmp_path_factory.mktemp("uninterrupted")
    assert run_app(["run", *map(str, [tiny_bundle, scene, "--out", out, *RUN_OPTIONS])]) == 0
    return contents(out)


RUN_OPTIONS = ["--format", "nuscenes", "--maps", "--draw"]


@pytest.mark.parametrize("signal_name", ["SIGINT", "SIGTERM", "SIGKILL"])
def test_p2_a_run_interrupted_at_random_moments_is_resumed_to_the_same_bytes(
    tiny_bundle, scene, uninterrupted, tmp_path, signal_name
):
    """One run is interrupted and resumed until it is finished; more runs follow until NUM_INTERRUPTIONS is reached."""
    rng, interruptions, runs = random.Random(signal_name), 0, 0
    arguments = ["run", tiny_bundle, scene, *RUN_OPTIONS, "--resume"]
    while runs == 0 or interruptions < NUM_INTERRUPTIONS:
        out, runs = tmp_path / str(runs), runs + 1
        results = out / "results.jsonl"
        while True:
            before = count_lines(results)
            if rng.random() < 0.6:
                process, target = start([*arguments, "--out", out]), before + rng.randrange(4, 16)
                wait_for(
                    lambda p=process, t=target, r=results: p.poll() is not None or count_lines(r) >= t, timeout_s=600
                )
            else:  # while packages are imported, while the bundle is loaded, or while the history is restored
                process = start_until_import([*arguments, "--out", out], rng.randrange(1, 600))
            time.sleep(rng.random() * 0.3)
            process.send_signal(getattr(signal, signal_name))
            _, err = process.communicate(timeout=600)
            assert "Traceback" not in err
            if process.returncode == 0:
                break
            interruptions += 1
            assert process.returncode == (-9 if signal_name == "SIGKILL" else 130), err
            complete = results.read_bytes().split(b"\n")[:-1] if results.exists() else []
            assert all(json.loads(line) for line in complete)
        assert contents(out) == uninterrupted


def count_lines(path: Path) -> int:
    return path.read_bytes().count(b"\n") if path.exists() else 0


@pytest.mark.parametrize("kept", [0, 1, 6, 19, NUM_FRAMES - 1, NUM_FRAMES])
def test_p2_a_run_resumes_after_any_frame(tiny_bundle, scene, uninterrupted, tmp_path, kept):
    """After lost cameras, after a skipped frame, before the first and after the last frame; with an incomplete line."""
    for name, content in uninterrupted.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(content)
    (tmp_path / "results_nusc.json").unlink()
    lines = uninterrupted["results.jsonl"].splitlines(keepends=True)
    (tmp_path / "results.jsonl").write_bytes(b"".join(lines[:kept]) + (lines[kept][:777] if kept < NUM_FRAMES else b""))
    for number in range(kept, NUM_FRAMES):
        for picture in [*(tmp_path / "maps").glob(f"{number:06d}_*.png"), tmp_path / "pictures" / f"{number:06d}.png"]:
            picture.unlink()
    for temporary in (".run.0a1b2c3d.json", "pictures/.000007.0a1b2c3d.png", ".results_nusc.0a1b2c3d.json"):
        (tmp_path / temporary).parent.mkdir(exist_ok=True)
        (tmp_path / temporary).write_bytes(b"left by a killed run")
    arguments = [tiny_bundle, scene, "--out", tmp_path, *RUN_OPTIONS, "--resume"]
    assert run_app(["run", *map(str, arguments)]) == 0
    assert contents(tmp_path) == uninterrupted


def test_p2_a_resumed_video_holds_every_frame(tiny_bundle, tmp_path):
    arguments = ["run", str(tiny_bundle), "synthetic:5:6", "--out", str(tmp_path), "--draw", "--video"]
    assert run_app(arguments) == 0
    whole = (tmp_path / "video.mp4").read_bytes()
    lines = (tmp_path / "results.jsonl").read_bytes().splitlines(keepends=True)
    (tmp_path / "results.jsonl").write_bytes(b"".join(lines[:4]))
    (tmp_path / "video.mp4").unlink()
    assert run_app([*arguments, "--resume"]) == 0
    assert (tmp_path / "video.mp4").read_bytes() == whole


OTHER_JOBS = {
    "another source": (["synthetic:6:3"], "the run began with source 'synthetic:5:3'; got 'synthetic:6:3'"),
    "maps": ([DRIVE, "--maps"], "the run began with maps False; got True"),
    "another policy": (
        [DRIVE, "--on-missing", "skip"],
        "the run began with on_missing 'blank'; got 'skip'",
    ),
    "another number of threads": ([DRIVE, "--threads", "7"], "the run began with threads"),
    "a video without its pictures": ([DRIVE, "--video"], "--resume --video: expected --draw too"),
    "pictures": ([DRIVE, "--draw"], "the run began with draw False; got True"),
    "overwriting too": ([DRIVE, "--overwrite"], "either --overwrite or --resume; got both"),
}


@pytest.mark.parametrize("job", OTHER_JOBS)
def test_p2_a_run_is_only_resumed_with_the_same_settings(tiny_bundle, tmp_path, capfd, job):
    other, words = OTHER_JOBS[job]
    assert run_app(["run", str(tiny_bundle), DRIVE, "--out", str(tmp_path)]) == 0
    before = contents(tmp_path)
    assert run_app(["run", str(tiny_bundle), *other, "--out", str(tmp_path), "--resume"]) == 2
    assert words in capfd.readouterr().err
    assert contents(tmp_path) == before


def test_p2_pictures_are_only_resumed_with_the_same_settings(tiny_bundle, tmp_path, capfd):
    arguments = ["run", str(tiny_bundle), DRIVE, "--out", str(tmp_path), "--draw"]
    assert run_app(arguments) == 0
    assert run_app([*arguments, "--resume", "--min-score", "0.7"]) == 2
    assert "the run began with min_score 0.3; got 0.7" in capfd.readouterr().err


def test_p2_resuming_a_finished_run_changes_nothing(tiny_bundle, tmp_path):
    arguments = ["run", str(tiny_bundle), DRIVE, "--out", str(tmp_path), "--draw"]
    assert run_app([*arguments, "--format", "nuscenes", "--video"]) == 0
    before = contents(tmp_path)
    assert run_app([*arguments, "--resume"]) == 0
    assert contents(tmp_path) == before


def test_p2_two_runs_do_not_write_to_one_folder(tiny_bundle, tmp_path, capfd):
    arguments = ["run", str(tiny_bundle), "synthetic:5:400", "--out", str(tmp_path)]
    first = start(arguments)
    wait_for(lambda: count_lines(tmp_path / "results.jsonl") >= 2, timeout_s=600)
    for option in ("--resume", "--overwrite"):
        assert run_app([*arguments, option]) == 5
        assert "another run is writing there" in capfd.readouterr().err
    first.kill()
    first.communicate()
    assert run_app([*arguments, "--resume", "--on-missing", "skip"]) == 2


@pytest.mark.parametrize("num_imports", [1, 50, 200, 400])
@pytest.mark.parametrize("signal_number", [signal.SIGINT, signal.SIGTERM])
def test_p2_an_interruption_during_imports_prints_no_traceback(tmp_path, tiny_bundle, num_imports, signal_number):
    process = start_until_import(["run", tiny_bundle, "synthetic:1:2000", "--out", tmp_path], num_imports)
    process.send_signal(signal_number)
    _, err = process.communicate(timeout=600)
    assert "Traceback" not in err
    assert process.returncode == 130


def test_p2_results_of_another_origin_are_not_resumed(tiny_bundle, tmp_path, capfd):
    arguments = ["run", str(tiny_bundle), DRIVE, "--out", str(tmp_path), "--resume"]
    assert run_app(arguments) == 0
    path = tmp_path / "results.jsonl"
    original = path.read_text()
    for damaged, words in (
        (original.replace('"timestamp_s": 15', '"timestamp_s": 25'), "is not a frame of this source"),
        (original + original, "is not a frame of this source"),
        ("[]\n", "line 1: expected a frame's results"),
        (original.replace('"boxes": [{', '"boxes": 3, "more": [{', 1), "line 1: expected a frame's results"),
        (original.replace('"score"', '"points"', 1), "line 1: expected a frame's results"),
        (original.replace('"skipped": null', '"skipped": 0', 1), "line 1: expected a frame's results"),
        ("[" * 100_000 + "\n", "line 1: expected a frame's results"),
        ('{"boxes": []}\n', "line 1: expected a frame's results"),
    ):
        path.write_text(damaged)
        assert run_app(arguments) == 5
        assert words in capfd.readouterr().err
        assert path.read_text() == damaged


def test_p2_an_incomplete_line_is_removed_and_complete_ones_stay(tmp_path):
    path = tmp_path / "results.jsonl"
    for content, kept in ((b"", b""), (b'{"a": 1', b""), (b'{"a": 1}\n{"b', b'{"a": 1}\n'), (b"{}\n", b"{}\n")):
        path.write_bytes(content)
        drop_partial_line(path)
        assert path.read_bytes() == kept
    assert list(read_results(tmp_path / "none")) == []
