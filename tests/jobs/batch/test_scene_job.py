"""The job of one scene, in this process."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from duospacenet.data.scene_writer import write_scene
from duospacenet.jobs.batch import scene_job
from duospacenet.jobs.batch.batch_records import BatchSettings
from duospacenet.jobs.batch.scene_job import MAX_TRIES, SceneJob, batch_run_settings
from duospacenet.jobs.batch.scene_list import find_scenes
from duospacenet.runtime.cores import available_cores
from duospacenet.runtime.errors import UsageError
from duospacenet.runtime.progress import no_progress
from duospacenet.synthetic.drive import SyntheticDrive
from tests.helpers.batch_results import files_of_run, scene_results
from tests.helpers.scene_files import edit_scene
from tests.helpers.streams import TINY_SIZE_PX


def settings_for(bundle: Path, out: Path, **changes) -> BatchSettings:
    settings = BatchSettings(
        bundle=str(bundle),
        out=str(out),
        call="first",
        run_settings={},
        maps=True,
        on_missing="blank",
        history_step_s=None,
        threads=available_cores(),
        engine="onnxruntime",
        engine_precision="float32",
        fast_decoding=False,
        check=True,
    )
    return replace(settings, run_settings=batch_run_settings(settings, ""), **changes)


def find(source):
    [scene] = find_scenes([source], check_tokens=False, progress=no_progress, notify=print)
    return scene


@pytest.fixture
def out(tmp_path) -> Path:
    (tmp_path / "out" / "scenes").mkdir(parents=True)
    (tmp_path / "out" / "unfinished").mkdir()
    return tmp_path / "out"


def test_one_job_runs_scenes_as_if_each_had_its_own_process(tiny_bundle, scene_folders, run_of_each_scene, out):
    """No state passes from one scene to the next."""
    job, reported = SceneJob(settings_for(tiny_bundle, out), "me"), []
    for folder in scene_folders:
        outcome = job.run(find(folder), reported.append)
        assert (outcome.status, outcome.frames, outcome.new_frames, outcome.worker) == ("done", 4, 4, "me")
        assert json.loads((out / outcome.folder / "summary.json").read_text()) == outcome.model_dump(mode="json")
    assert reported == [0, 1, 2, 3, 4] * 4
    assert scene_results(out) == run_of_each_scene


def test_one_scene_of_a_source_is_a_run_of_its_own(tiny_bundle, scene_folders, run_of_each_scene, out, tmp_path):
    """Two drives in one scene folder, which `run` would process one after the other."""
    frames = [
        replace(frame, scene=name, token=f"{name}-{index}")
        for number, name in ((1, "city"), (2, "bridge"))
        for index, frame in enumerate(SyntheticDrive(number, frames=4, image_size=TINY_SIZE_PX, grid=(16, 16)))
    ]
    write_scene(tmp_path / "both", frames)
    scenes = find_scenes([tmp_path / "both"], check_tokens=False, progress=no_progress, notify=print)
    job = SceneJob(settings_for(tiny_bundle, out), "me")
    for scene in reversed(scenes):
        assert job.run(scene).is_done
        files, expected = files_of_run(out / "scenes" / scene.scene_id), dict(run_of_each_scene[scene.scene_id])
        last = scene.piece.first + 3
        source = json.loads(files.pop("run.json"))["source"]
        assert source.endswith(f"scene '{scene.scene_id}', frames {scene.piece.first} to {last}")
        del expected["run.json"]
        assert files == expected


def test_a_scene_that_is_finished_is_not_run_again(tiny_bundle, scene_folders, out):
    """Ray repeats a task if the actor was lost after its last step."""
    job, scene = SceneJob(settings_for(tiny_bundle, out), "me"), find(scene_folders[0])
    first = job.run(scene)
    assert SceneJob(settings_for(tiny_bundle, out), "other").run(scene) == first


def test_an_unfinished_scene_is_continued(tiny_bundle, scene_folders, run_of_each_scene, out):
    unfinished = out / "unfinished" / "city"
    unfinished.mkdir()
    (unfinished / "run.json").write_bytes(run_of_each_scene["city"]["run.json"])
    lines = run_of_each_scene["city"]["results.jsonl"].splitlines(keepends=True)
    (unfinished / "results.jsonl").write_bytes(b"".join(lines[:3]) + lines[3][:50])
    (unfinished / "maps").mkdir()
    for name, content in run_of_each_scene["city"].items():
        if name.startswith("maps/"):
            (unfinished / name).write_bytes(content)
    outcome = SceneJob(settings_for(tiny_bundle, out), "me").run(find(scene_folders[0]))
    assert (outcome.frames, outcome.new_frames) == (4, 1)
    assert scene_results(out) == {"city": run_of_each_scene["city"]}


DISCARDED = {
    "of another scene.json": lambda runs: (runs["bridge"]["run.json"], runs["bridge"]["results.jsonl"]),
    "of other frames": lambda runs: (runs["city"]["run.json"], runs["bridge"]["results.jsonl"]),
    "with too many frames": lambda runs: (runs["city"]["run.json"], 2 * runs["city"]["results.jsonl"]),
    "with a damaged line": lambda runs: (runs["city"]["run.json"], b"{}\n"),
}


@pytest.mark.parametrize("case", DISCARDED)
def test_unfinished_results_that_cannot_be_continued_are_discarded(
    tiny_bundle, scene_folders, run_of_each_scene, out, case
):
    unfinished = out / "unfinished" / "city"
    unfinished.mkdir()
    run_json, results = DISCARDED[case](run_of_each_scene)
    (unfinished / "run.json").write_bytes(run_json)
    (unfinished / "results.jsonl").write_bytes(results)
    assert SceneJob(settings_for(tiny_bundle, out), "me").run(find(scene_folders[0])).new_frames == 4
    assert scene_results(out) == {"city": run_of_each_scene["city"]}


def test_a_scene_is_begun_a_limited_number_of_times_per_call(tiny_bundle, scene_folders, out, monkeypatch):
    scene = find(scene_folders[0])

    def killed(*arguments, **options):
        raise SystemExit  # passes all handlers of exceptions, as the end of a process does

    with monkeypatch.context() as patch:
        patch.setattr(scene_job, "run_stream", killed)
        for _ in range(MAX_TRIES):
            with pytest.raises(SystemExit):
                SceneJob(settings_for(tiny_bundle, out), "me").run(scene)
    outcome = SceneJob(settings_for(tiny_bundle, out), "me").run(scene)
    assert (outcome.status, outcome.tries) == ("failed", MAX_TRIES)
    assert outcome.cause == "its worker process ended in each of 3 tries"
    outcome = SceneJob(settings_for(tiny_bundle, out, call="second"), "me").run(scene)
    assert (outcome.status, outcome.tries) == ("done", 1)


def test_data_that_changed_since_the_beginning_of_the_batch_fail(tiny_bundle, scene_folders, out, tmp_path):
    folder = Path(shutil.copytree(scene_folders[0], tmp_path / "city"))
    scene = find(folder)
    edit_scene(folder, lambda record: record["frames"].pop())
    outcome = SceneJob(settings_for(tiny_bundle, out), "me").run(scene)
    assert not outcome.is_done and "expected the same data as when the batch began" in outcome.cause


@pytest.mark.parametrize("pose", ["NaN", "1e999", "null", '"x"'])
def test_a_pose_that_is_no_number_fails_with_its_file(tiny_bundle, scene_folders, out, tmp_path, pose):
    folder = Path(shutil.copytree(scene_folders[0], tmp_path / "city"))
    edit_scene(folder, lambda record: record["frames"][2]["global_T_ego"][0].__setitem__(3, 123456.5))
    text = (folder / "scene.json").read_text()
    assert text.count("123456.5") == 1
    (folder / "scene.json").write_text(text.replace("123456.5", pose))
    outcome = SceneJob(settings_for(tiny_bundle, out), "me").run(find(folder))
    assert not outcome.is_done and "scene.json" in outcome.cause and "\n" not in outcome.cause


def test_a_bug_fails_the_scene_with_its_name(tiny_bundle, scene_folders, out, monkeypatch):
    def fail(*arguments, **options):
        raise ZeroDivisionError("no speed")

    monkeypatch.setattr(scene_job, "check_source", fail)
    outcome = SceneJob(settings_for(tiny_bundle, out), "me").run(find(scene_folders[0]))
    assert outcome.cause == "internal error: ZeroDivisionError: no speed"


def test_a_worker_with_other_versions_is_refused(tiny_bundle, out):
    settings = settings_for(tiny_bundle, out)
    other = replace(settings, run_settings={**settings.run_settings, "onnxruntime": "1.0.0"})
    with pytest.raises(UsageError, match=r"worker: expected onnxruntime '1\.0\.0'.*Install the same versions"):
        SceneJob(other, "me")
