"""Batches in local processes."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from duospacenet import jobs
from duospacenet.cli.main import run_app
from duospacenet.runtime.cores import available_cores
from duospacenet.runtime.errors import ArtifactError, OutputError, UsageError
from tests.helpers.batch_results import scene_results
from tests.helpers.bundles import edit_manifest
from tests.helpers.nuscenes_roots import write_small_root
from tests.helpers.output_files import contents
from tests.helpers.process_tree import child_processes, is_running
from tests.helpers.processes import start, wait_for
from tests.helpers.scene_files import edit_scene, front_image
from tests.helpers.worker_faults import WorkerFaults

THREADS = available_cores()  # as the runs that the batches are compared with
TIMEOUT_S = 120


def run_batch(bundle, sources, out, **options):
    return jobs.run_batch(bundle, sources, out, **{"threads": THREADS, "maps": True, **options})


@pytest.mark.parametrize("workers", [1, 4])
def test_a_batch_writes_what_run_writes_for_each_scene(
    tiny_bundle, scene_folders, run_of_each_scene, tmp_path, workers
):
    summary = run_batch(tiny_bundle, scene_folders, tmp_path, workers=workers)
    assert scene_results(tmp_path) == run_of_each_scene
    assert sorted(path.name for path in tmp_path.iterdir()) == ["batch.json", "scenes", "summary.json"]
    assert json.loads((tmp_path / "summary.json").read_text()) == summary.to_dict()
    assert len({outcome.worker for outcome in summary.outcomes}) == workers
    assert [row.frames for row in summary.workers] == [16 // workers] * workers
    assert (summary.failed, summary.lost_workers, summary.new_frames) == ([], 0, 16)
    assert all(0 < row.frames_per_s < 1000 for row in summary.workers)


def test_the_submission_of_a_batch_is_that_of_a_run_over_all_sources(tiny_bundle, scene_folders, tmp_path):
    root = write_small_root(tmp_path / "root", num_scenes=2, num_frames=2)
    sources = [f"nuscenes:{root}", scene_folders[0]]
    run_batch(tiny_bundle, sources, tmp_path / "batch", workers=2, formats="nuscenes")
    jobs.run(tiny_bundle, sources, tmp_path / "run", maps=True, threads=THREADS, formats="nuscenes")
    submissions = [(tmp_path / name / "results_nusc.json").read_bytes() for name in ("batch", "run")]
    assert submissions[0] == submissions[1]
    jobs.run(tiny_bundle, f"nuscenes:{root}/scene-0103", tmp_path / "scene-0103", maps=True, threads=THREADS)
    of_run, of_batch = contents(tmp_path / "scene-0103"), scene_results(tmp_path / "batch")["scene-0103"]
    del of_run["run.json"], of_batch["run.json"]  # the source of a scene is a split there, and a part of a source here
    assert of_batch == of_run


@pytest.fixture
def damaged(scene_folders, tmp_path) -> dict[str, Path]:
    """Copies of the scenes. `bridge` has a broken image."""
    folder = tmp_path / "sources"
    folder.mkdir()
    scenes = {scene.name: Path(shutil.copytree(scene, folder / scene.name)) for scene in scene_folders}
    image = front_image(scenes["bridge"], 3)
    image.write_bytes(image.read_bytes()[:-40])
    return scenes


def test_a_lost_worker_costs_nothing_and_a_poisoned_scene_fails_alone(
    tiny_bundle, scene_folders, damaged, run_of_each_scene, tmp_path, monkeypatch, capfd
):
    """`city` kills its worker once, `tunnel` each time. `bridge` has a broken image, and `park` an impossible pose."""
    original = (damaged["park"] / "scene.json").read_text()
    edit_scene(damaged["park"], lambda scene: scene["frames"][2]["global_T_ego"][0].__setitem__(0, 7.0))
    out, sources = tmp_path / "out", list(damaged.values())
    faults = WorkerFaults(tmp_path / "faults", out)
    faults.kill(damaged["city"], 3, once=True)
    faults.kill(damaged["tunnel"], 3, once=False)
    arguments = ["batch", tiny_bundle, *sources, "--out", out, "--workers", 2, "--threads", THREADS, "--maps", "--json"]
    with monkeypatch.context() as patch:
        for name, value in faults.environment().items():
            patch.setenv(name, value)
        assert run_app([str(argument) for argument in arguments]) == 1
    stdout, stderr = capfd.readouterr()
    summary = json.loads(stdout)
    assert (summary["done"], summary["failed"], summary["lost_workers"]) == (1, 3, 4)
    outcomes = {outcome["scene"]: outcome for outcome in summary["outcomes"]}
    assert (outcomes["city"]["status"], outcomes["city"]["tries"]) == ("done", 2)
    assert scene_results(out) == {"city": run_of_each_scene["city"]}
    assert "its worker process ended in each of 3 tries (the last process: signal 9" in outcomes["tunnel"]["cause"]
    assert "CAM_FRONT/000003.png" in outcomes["bridge"]["cause"]
    assert "frame 2: global_T_ego" in outcomes["park"]["cause"]
    assert "error: 3 of 4 scenes failed: bridge, tunnel, park. The causes are in" in stderr

    # What was wrong is repaired, and the batch is resumed.
    shutil.copy(front_image(scene_folders[1], 3), front_image(damaged["bridge"], 3))
    (damaged["park"] / "scene.json").write_text(original)
    city = (out / "scenes" / "city" / "results.jsonl").stat()
    assert run_app([str(argument) for argument in [*arguments, "--resume"]]) == 0
    summary = json.loads(capfd.readouterr().out)
    assert (summary["done"], summary["failed"], summary["new_scenes"]) == (4, 0, 3)
    assert summary["frames"] == 16 and summary["new_frames"] < 12
    assert scene_results(out) == run_of_each_scene
    assert (out / "scenes" / "city" / "results.jsonl").stat() == city
    assert not (out / "unfinished").exists()


@pytest.mark.parametrize("signal_number", [signal.SIGINT, signal.SIGKILL])
def test_an_interrupted_batch_leaves_no_process_and_is_resumed_to_the_same_bytes(
    tiny_bundle, scene_folders, run_of_each_scene, tmp_path, capfd, signal_number
):
    out, sources = tmp_path / "out", scene_folders[:2]
    faults = WorkerFaults(tmp_path / "faults", out)
    for scene in sources:
        faults.wait(scene, 2)
    arguments = ["batch", tiny_bundle, *sources, "--out", out, "--workers", 2, "--threads", THREADS, "--maps"]
    process = start(arguments, env=os.environ | faults.environment())
    results = [out / "unfinished" / scene.name / "results.jsonl" for scene in sources]
    wait_for(lambda: all(path.exists() and path.stat().st_size for path in results), TIMEOUT_S)
    workers = child_processes(process.pid)
    assert len(workers) == 2 and all(map(is_running, workers))
    assert run_app([str(argument) for argument in [*arguments, "--resume"]]) == 5
    assert "another run is writing there" in capfd.readouterr().err
    process.send_signal(signal_number)
    time.sleep(1)  # the workers notice that they have to end
    faults.go_on()
    _, stderr = process.communicate(timeout=TIMEOUT_S)
    if signal_number == signal.SIGINT:
        assert process.returncode == 130
        assert "interrupted; finished results are on disk; add --resume to continue" in stderr
        assert not any(map(is_running, workers))
    else:
        assert process.returncode == -signal.SIGKILL
        wait_for(lambda: not any(map(is_running, workers)), TIMEOUT_S)
    assert not (out / "summary.json").exists()
    for path in results:
        assert run_of_each_scene[path.parent.name]["results.jsonl"].startswith(path.read_bytes())
        assert path.read_bytes().endswith(b"\n")
    run_batch(tiny_bundle, sources, out, workers=2, resume=True)
    assert scene_results(out) == {scene.name: run_of_each_scene[scene.name] for scene in sources}


def test_a_bundle_that_cannot_be_loaded_ends_the_batch(copied_bundle, scene_folders, tmp_path):
    edit_manifest(copied_bundle, lambda manifest: manifest["parity"].update(passed=False))
    with pytest.raises(ArtifactError, match="expected a passed parity report"):
        run_batch(copied_bundle, scene_folders, tmp_path / "out", workers=2)
    assert contents(tmp_path / "out") == {}  # so that the next call needs no --resume


REFUSED = {
    "a misspelt source": ({"sources": ["no_such_folder"]}, 3, "expected a scene folder"),
    "an unknown format": ({"--format": "csv"}, 2, "--format: expected jsonl or nuscenes"),
    "an unknown policy": ({"--on-missing": "guess"}, 2, "--on-missing: expected"),
    "too many threads": ({"--threads": "5000"}, 2, "threads: expected 1 to 1024"),
    "too many workers": ({"--workers": "5000"}, 2, "--workers: expected 1 to 1024"),
    "a bundle that does not exist": ({"bundle": "no_such_bundle"}, 4, "no_such_bundle"),
    "an address that is none": ({"--ray": "ray://head:10001"}, 2, "--ray: expected local, auto or HOST:PORT"),
    "a submission without its format": ({"--submission-min-score": "0.1"}, 2, "--format nuscenes too"),
    "no history of that step": ({"--history-step": "9"}, 2, "--history-step"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_wrong_call_is_refused_before_any_work(tiny_bundle, scene_folders, tmp_path, capfd, case):
    changes, code, words = REFUSED[case]
    options = {name: value for name, value in changes.items() if name.startswith("--")}
    sources = [scene_folders[0], *changes.get("sources", [])]
    arguments = [changes.get("bundle", tiny_bundle), *sources, "--out", tmp_path / "out"]
    arguments += [word for option in options.items() for word in option]
    assert run_app(["batch", *map(str, arguments)]) == code
    assert words in capfd.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_folder_with_other_files_of_these_names_is_not_touched(tiny_bundle, scene_folders, tmp_path):
    (tmp_path / "scenes").mkdir()
    (tmp_path / "scenes" / "mine.txt").write_text("mine")
    for resume in (False, True):
        with pytest.raises(OutputError, match=r"there is no batch\.json beside it"):
            run_batch(tiny_bundle, scene_folders, tmp_path, resume=resume)
    assert contents(tmp_path) == {"scenes/mine.txt": b"mine"}


@pytest.fixture(scope="module")
def finished(tiny_bundle, scene_folders, tmp_path_factory) -> Path:
    """The folder of a batch over one scene, with a picture of no batch in it. Tests that change it make a copy."""
    out = tmp_path_factory.mktemp("batches") / "finished"
    run_batch(tiny_bundle, scene_folders[0], out)
    return out


def test_a_finished_batch_is_only_continued_with_resume(tiny_bundle, scene_folders, finished):
    before = contents(finished)
    with pytest.raises(OutputError, match="an earlier batch wrote this"):
        run_batch(tiny_bundle, scene_folders[0], finished)
    assert contents(finished) == before
    summary = run_batch(tiny_bundle, scene_folders[0], finished, resume=True)
    assert summary.new_frames == 0 and summary.count("frames") == 4
    assert contents(finished / "scenes") == {
        name.removeprefix("scenes/"): content for name, content in before.items() if name.startswith("scenes/")
    }


def test_more_sources_can_be_added(tiny_bundle, scene_folders, run_of_each_scene, finished, tmp_path):
    out = Path(shutil.copytree(finished, tmp_path / "out"))
    run_batch(tiny_bundle, [*scene_folders[:2]], out, resume=True)
    assert scene_results(out) == {name: run_of_each_scene[name] for name in ("city", "bridge")}


OTHER_BATCHES = {
    "other options": ({"maps": False}, "the batch began with maps True; got False"),
    "other threads": ({"threads": 7}, "the batch began with threads"),
    "other sources": ({"sources": 1}, "scenes/city: expected a scene of these sources"),
}


@pytest.mark.parametrize("case", OTHER_BATCHES)
def test_a_batch_is_only_resumed_with_the_same_settings(tiny_bundle, scene_folders, finished, case):
    changes, words = OTHER_BATCHES[case]
    changes = dict(changes)
    before = contents(finished)
    with pytest.raises(UsageError, match=words):
        run_batch(tiny_bundle, scene_folders[changes.pop("sources", 0)], finished, resume=True, **changes)
    assert contents(finished) == before


def test_a_finished_scene_whose_source_has_changed_is_not_mixed_with_others(
    tiny_bundle, scene_folders, finished, tmp_path
):
    folder = Path(shutil.copytree(scene_folders[0], tmp_path / "city"))
    edit_scene(folder, lambda scene: scene["frames"][0].update(timestamp_s=1.0))
    before = contents(finished)
    with pytest.raises(UsageError, match="the scene began with source"):
        run_batch(tiny_bundle, folder, finished, resume=True)
    assert contents(finished) == before


def test_a_missing_extra_is_named_before_any_work(tiny_bundle, scene_folders, tmp_path, monkeypatch, capfd):
    monkeypatch.setattr("duospacenet.jobs.batch.ray_pool.find_spec", lambda name: None)
    arguments = ["batch", tiny_bundle, scene_folders[0], "--out", tmp_path / "out", "--ray", "local"]
    assert run_app(list(map(str, arguments))) == 6
    assert "pip install 'duospacenet[ray]'" in capfd.readouterr().err
    assert not (tmp_path / "out").exists()


def test_local_workers_need_no_ray():
    code = (
        "import sys, duospacenet.jobs.batch.batch_job, duospacenet.jobs.batch.worker, duospacenet.jobs.batch.scene_job;"
        "assert not {'ray', 'pandas', 'pyarrow'} & set(sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
    assert done.returncode == 0, done.stderr
