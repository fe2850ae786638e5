"""The process and its environment: rows P1, P2 and P4 to P8 of the reliability list. P3 is in test_memory.py."""

import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from unittest import mock

import pytest

from duospacenet.cli.main import run_app
from duospacenet.data.results import ResultsFile, drop_partial_line, read_results
from duospacenet.data.scene_writer import write_scene
from duospacenet.runtime.errors import OutputError
from duospacenet.runtime.files import write_atomically
from duospacenet.synthetic.drive import SyntheticDrive
from tests.helpers.output_files import contents
from tests.helpers.processes import call, start, start_until_import, wait_for
from tests.helpers.streams import TINY_SIZE_PX, detect_all, lose_cameras

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


def limit_files(size: int):
    """For a child process: no file can be larger than `size` bytes, as on a full disk."""
    return lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))


# --- P1: disk full ------------------------------------------------------------------------------------------------


def test_p1_a_failed_write_leaves_the_old_file_and_no_other(tmp_path):
    path = tmp_path / "a.bin"
    path.write_bytes(b"old")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 20, hard))
    try:
        with pytest.raises(OutputError, match=r"a\.bin: File too large"):
            write_atomically(path, bytes(2 << 20))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_p1_a_file_is_on_disk_before_it_gets_its_name(tmp_path, monkeypatch):
    order = []
    fsync, replace = os.fsync, Path.replace
    monkeypatch.setattr(os, "fsync", lambda descriptor: order.append("fsync") or fsync(descriptor))
    monkeypatch.setattr(Path, "replace", lambda path, target: order.append("replace") or replace(path, target))
    write_atomically(tmp_path / "a.bin", b"new")
    assert order == ["fsync", "replace"]


def test_p1_a_line_that_does_not_fit_leaves_no_part_of_it(tmp_path):
    record = {"boxes": ["x" * 1000]}
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    with ResultsFile(tmp_path / "results.jsonl") as lines:
        resource.setrlimit(resource.RLIMIT_FSIZE, (2500, hard))
        try:
            lines.write(record)
            lines.write(record)
            with pytest.raises(OutputError, match=r"results\.jsonl: File too large"):
                lines.write(record)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        lines.write({"boxes": []})
    written = [json.loads(line) for line in (tmp_path / "results.jsonl").read_text().splitlines()]
    assert written == [record, record, {"boxes": []}]


@pytest.mark.parametrize(
    ("options", "limit"), [([], 150_000), (["--draw"], 60_000), (["--format", "nuscenes"], 400_000)]
)
def test_p1_a_run_on_a_full_disk_ends_with_5_and_leaves_complete_files(tiny_bundle, tmp_path, options, limit):
    out = tmp_path / "out"
    done = call(["run", tiny_bundle, "synthetic:5:9", "--out", out, *options], preexec_fn=limit_files(limit))
    assert done.returncode == 5
    assert "cannot write" in done.stderr
    assert "File too large" in done.stderr
    assert "Traceback" not in done.stderr
    lines = (out / "results.jsonl").read_text().splitlines()
    assert len(lines) < 9
    assert all(len(json.loads(line)["boxes"]) == 320 for line in lines)
    assert not [path for path in out.rglob(".*") if path.is_file()]
    assert run_app(["run", str(tiny_bundle), "synthetic:5:9", "--out", str(out), "--resume", *options]) == 0
    assert len((out / "results.jsonl").read_text().splitlines()) == 9


def test_p1_an_export_on_a_full_disk_leaves_nothing(tmp_path):
    arguments = ["export", "--preset", "tiny", "--random-weights", "--out", tmp_path / "bundle"]
    done = call(arguments, preexec_fn=limit_files(1000))
    assert done.returncode == 5
    assert "Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("arguments", [["inspect", "{bundle}"], ["inspect", "{bundle}", "--json"]])
def test_p1_a_full_standard_output_is_reported(tiny_bundle, arguments):
    with open("/dev/full", "w") as full:  # noqa: PTH123
        done = call([argument.format(bundle=tiny_bundle) for argument in arguments], **redirected_to(full))
    assert done.returncode == 5
    assert "No space left on device" in done.stderr
    assert "Traceback" not in done.stderr
    assert "Exception ignored" not in done.stderr


def redirected_to(stdout) -> dict:
    return {"capture_output": False, "stdout": stdout, "stderr": subprocess.PIPE}


# --- P2: Ctrl-C, SIGTERM, kill -9 ---------------------------------------------------------------------------------


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
        assert sorted(path.name for path in out.iterdir()) == ["maps", "pictures", "results.jsonl", "run.json"]


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


# --- P4: threads, quota, affinity ---------------------------------------------------------------------------------


def test_p4_a_process_bound_to_one_core_uses_one_thread(tiny_bundle, tmp_path):
    done = call(
        ["run", tiny_bundle, DRIVE, "--out", tmp_path],
        preexec_fn=lambda: os.sched_setaffinity(0, {min(os.sched_getaffinity(0))}),
    )
    assert done.returncode == 0
    assert json.loads((tmp_path / "run.json").read_text())["threads"] == 1


def test_p4_four_streams_have_the_throughput_of_one_stream(pipeline, frames):
    """At least 0.8 of it in the best of five measurements, because other processes may use the machine."""

    def throughput(num_streams: int) -> float:
        start_s = time.perf_counter()
        with ThreadPoolExecutor(num_streams) as threads:
            list(
                threads.map(
                    lambda _: [detect_all(pipeline, frames) for _ in range(8 // num_streams)], range(num_streams)
                )
            )
        return 1 / (time.perf_counter() - start_s)

    throughput(4)
    ratios = []
    while len(ratios) < 5 and max(ratios, default=0) < 0.8:
        ratios.append(throughput(4) / throughput(1))
    assert max(ratios) >= 0.8


# --- P5: determinism ----------------------------------------------------------------------------------------------

DIGEST = """
import hashlib, sys
from duospacenet.runtime import Pipeline
from duospacenet.synthetic.drive import SyntheticDrive

pipeline = Pipeline.load(sys.argv[1], threads=int(sys.argv[2]))
frames = list(SyntheticDrive(1, frames=5, image_size=(160, 64)))
for _ in range(20):
    stream, digest = pipeline.stream(maps=True), hashlib.sha256()
    for frame in frames:
        detections = stream.step(frame)
        for array in (detections.boxes, detections.scores, detections.queries, *detections.maps.values()):
            digest.update(array.tobytes())
    print(digest.hexdigest())
"""


@pytest.mark.parametrize("threads", [1, 2])
def test_p5_twenty_runs_in_each_of_two_processes_give_the_same_bits(tiny_bundle, threads):
    command = [sys.executable, "-c", DIGEST, str(tiny_bundle), str(threads)]
    printed = [subprocess.run(command, capture_output=True, text=True, check=True).stdout.split() for _ in range(2)]
    assert len(printed[0]) == len(printed[1]) == 20
    assert len({*printed[0], *printed[1]}) == 1


# --- P6: unwritable or existing output ----------------------------------------------------------------------------


SLOW_STEPS = (
    "duospacenet.runtime.Pipeline.load",
    "duospacenet.runtime.bundle.manifest.check_files",
    "duospacenet.synthetic.drive.SyntheticDrive.frame",
    "duospacenet.jobs.export_job.build_model",
)


def assert_refused_at_once(arguments) -> None:
    """The command ends with 5 before it loads a pipeline, reads a graph, renders a frame or builds a model.

    An AssertionError from one of these steps would end the command with another exit code.
    """
    with ExitStack() as patches:
        for name in SLOW_STEPS:
            patches.enter_context(mock.patch(name, side_effect=AssertionError(f"{name} was called")))
        assert run_app([*map(str, arguments)]) == 5


def test_p6_results_of_an_earlier_run_are_only_replaced_on_request(tiny_bundle, tmp_path, capfd):
    arguments = ["run", tiny_bundle, DRIVE, "--out", tmp_path]
    assert run_app([*map(str, arguments)]) == 0
    before = contents(tmp_path)
    assert_refused_at_once(arguments)
    assert "an earlier run wrote this file" in (message := capfd.readouterr().err)
    assert "--overwrite" in message
    assert "--resume" in message
    assert contents(tmp_path) == before
    assert run_app([*map(str, arguments), "--overwrite"]) == 0
    assert contents(tmp_path) == before


@pytest.mark.parametrize("option", ["--overwrite", "--resume"])
def test_p6_an_unwritable_folder_is_refused_at_once(tiny_bundle, tmp_path, option):
    (tmp_path / "file").write_text("mine")
    for place in ("/proc/none/out", "/dev/null/out", tmp_path / "file", tmp_path / "file" / "out"):
        assert_refused_at_once(["run", tiny_bundle, DRIVE, "--out", place])
        assert_refused_at_once(["run", tiny_bundle, DRIVE, "--out", place, option])
    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.parametrize("name", ["results.jsonl", "pictures/000000.png", "maps/000001_road.png", "video.mp4"])
def test_p6_files_that_no_run_wrote_are_never_changed(tiny_bundle, tmp_path, name):
    """They may be the images of the source."""
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_text("mine")
    for option in ([], ["--resume"], ["--overwrite"]):
        assert_refused_at_once(["run", tiny_bundle, DRIVE, "--out", tmp_path, *option])
    assert contents(tmp_path) == {name: b"mine"}


def test_p6_results_are_kept_if_the_bundle_is_invalid(tiny_bundle, tmp_path):
    assert run_app(["run", str(tiny_bundle), DRIVE, "--out", str(tmp_path / "out")]) == 0
    before = contents(tmp_path / "out")
    bad = shutil.copytree(tiny_bundle, tmp_path / "bad")
    with (bad / "decoder.onnx").open("ab") as file:
        file.write(b"x")
    for out in ("out", "fresh"):
        assert run_app(["run", str(bad), DRIVE, "--out", str(tmp_path / out), "--overwrite"]) == 4
    assert contents(tmp_path / "out") == before
    assert not (tmp_path / "fresh").exists()


def test_p6_a_demo_does_not_change_the_results_of_a_run(tmp_path):
    (tmp_path / "run.json").write_text('{"source": "my rig"}')
    (tmp_path / "results.jsonl").write_text("{}\n")
    before = contents(tmp_path)
    assert_refused_at_once(["demo", "--out", tmp_path])
    assert contents(tmp_path) == before


def test_p6_an_existing_bundle_is_refused_at_once(tiny_bundle):
    assert_refused_at_once(["export", "--preset", "tiny", "--random-weights", "--out", tiny_bundle])


# --- P7: no network, no torch -------------------------------------------------------------------------------------

WITHOUT_TORCH_AND_NETWORK = """
import socket, sys
from importlib.abc import MetaPathFinder

class Blocker(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in ("torch", "onnx", "onnx_ir", "onnxscript", "safetensors"):
            raise ImportError(f"{name} is not installed", name=name)

def refuse(*_arguments, **_options):
    raise SystemExit("the network was used")

sys.meta_path.insert(0, Blocker())
socket.socket.connect = socket.create_connection = socket.getaddrinfo = refuse
from duospacenet.cli.main import main
main()
"""


def test_p7_commands_work_without_torch_and_network(tiny_bundle, scene, tmp_path):
    run = ["run", tiny_bundle, scene, "--out", tmp_path / "out", "--draw", "--video", "--maps", "--format", "nuscenes"]
    for arguments in (run, ["inspect", tiny_bundle], ["inspect", tiny_bundle, "--json"]):
        command = [sys.executable, "-c", WITHOUT_TORCH_AND_NETWORK, *map(str, arguments)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
    assert len((tmp_path / "out" / "results.jsonl").read_text().splitlines()) == NUM_FRAMES


# --- P8: paths and locales ----------------------------------------------------------------------------------------

ODD_NAMES = ["with a space", "schön 写真 🚗", 'it\'s "quoted" & $HOME', "-dash"]


RUN_TWICE = """
import sys
from duospacenet.cli.main import run_app
for first in (1, 4):
    bundle, scene, out = sys.argv[first : first + 3]
    options = ["--draw", "--video", "--maps", "--format", "nuscenes"]
    code = run_app(["run", bundle, scene, "--out", out, *options])
    if code:
        sys.exit(code)
"""


@pytest.mark.parametrize("name", ODD_NAMES)
@pytest.mark.parametrize("locale", ["C", "C.UTF-8"])
def test_p8_odd_relative_and_absolute_paths_work_in_any_locale(tiny_bundle, tmp_path, name, locale):
    place = tmp_path / name
    place.mkdir()
    shutil.copytree(tiny_bundle, place / f"bundle {name}")
    write_scene(place / f"scene {name}", SyntheticDrive(5, frames=2, image_size=TINY_SIZE_PX))
    plain = {"LC_ALL": locale, "LANG": locale, "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    command = [sys.executable, "-c", RUN_TWICE]
    for folder, out in ((Path(), "relative"), (place, "absolute")):
        command += map(str, [folder / f"bundle {name}", folder / f"scene {name}", folder / f"{out} {name}"])
    done = subprocess.run(command, cwd=place, env=os.environ | plain, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr
    for out in ("relative", "absolute"):
        written = contents(place / f"{out} {name}")
        assert len(written["results.jsonl"].splitlines()) == 2
        assert {"video.mp4", "results_nusc.json", "pictures/000001.png"} <= written.keys()


TRACE = """
import sys
from pathlib import Path
from duospacenet.export.graphs import build_graphs
from duospacenet.export.tracing import trace
from duospacenet.model import PRESETS, DuoSpaceNet
trace(build_graphs(DuoSpaceNet(PRESETS["tiny"]).eval())[0], Path(sys.argv[1]) / "projector.onnx")
"""


def test_p8_a_graph_is_traced_to_an_odd_path_in_the_c_locale(tmp_path):
    folder = tmp_path / "schön 写真"
    folder.mkdir()
    plain = {"LC_ALL": "C", "LANG": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    command = [sys.executable, "-c", TRACE, str(folder)]
    done = subprocess.run(command, env=os.environ | plain, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert [path.name for path in folder.iterdir()] == ["projector.onnx"]


def test_p8_a_parity_check_takes_odd_paths(tiny_bundle, tiny_model, tmp_path):
    shutil.copytree(tiny_bundle, tmp_path / "schön 写真")
    arguments = ["parity", str(tmp_path / "schön 写真"), "--random-weights", "--source", "synthetic:3:1"]
    assert run_app(arguments) == 0
