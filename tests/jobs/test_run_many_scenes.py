"""Runs over several sources and scenes, and their resumption: inside a scene, between scenes and between sources."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from duospacenet import jobs
from duospacenet.data.results import read_results
from duospacenet.data.scene_writer import write_scene
from duospacenet.jobs import evaluate_bundle
from duospacenet.runtime.errors import UsageError
from duospacenet.synthetic.drive import SyntheticDrive
from tests.helpers.output_files import contents
from tests.helpers.streams import TINY_SIZE_PX, lose_cameras

FAST_STEPS = 18  # frames of the first scene, at 10 Hz: longer than the window of 1.5 s
OPTIONS = {"maps": True, "draw": True, "formats": "nuscenes", "history_step_s": 0.5}


def at_10_hz(frames, scene, start_s):
    """The frames 0.1 s apart at 10 m/s, as a scene of its own."""
    result = []
    for index, frame in enumerate(frames):
        pose = frames[0].global_T_ego.copy()
        pose[0, 3] += index
        token = f"{scene}-{start_s:g}-{index}"
        result.append(replace(frame, global_T_ego=pose, timestamp_s=start_s + 0.1 * index, scene=scene, token=token))
    return result


@pytest.fixture(scope="module")
def sources(tmp_path_factory) -> list[Path]:
    """Two folders. The first has two scenes; the first frame of the second scene has no image.

    The second folder has a scene with the name of the last one, which begins 0.1 s later at the same place.
    """
    folder = tmp_path_factory.mktemp("sources")
    images = list(SyntheticDrive(3, 6, image_size=TINY_SIZE_PX))
    long = at_10_hz([images[index % 6] for index in range(FAST_STEPS)], "long", 100.0)
    short = at_10_hz(images[:4], "short", 90.0)
    short[0] = lose_cameras(short[0], *short[0].cameras)
    following = at_10_hz(images[:4], "short", 90.4)
    write_scene(folder / "first", [*long, *short])
    write_scene(folder / "second", following)
    return [folder / "first", folder / "second"]


@pytest.fixture(scope="module")
def whole(tiny_bundle, sources, tmp_path_factory) -> Path:
    """The folder of an uninterrupted run."""
    out = tmp_path_factory.mktemp("whole")
    assert jobs.run(tiny_bundle, sources, out, **OPTIONS).frames == FAST_STEPS + 8
    return out


def test_the_history_is_reset_at_each_scene_and_each_source(whole):
    results = list(read_results(whole / "results.jsonl"))
    assert [result["scene"] for result in results] == ["long"] * 18 + ["short"] * 4 + ["short (source 2)"] * 4
    reasons = {index: result["history"]["reset_reason"] for index, result in enumerate(results)}
    assert {index: reason for index, reason in reasons.items() if reason} == {
        19: "new scene 'short' after 'long'",  # frame 18 has no image, so it is skipped
        22: "new scene 'short (source 2)' after 'short'",
    }
    assert results[18]["skipped"]
    assert results[17]["history"]["ages_s"] == pytest.approx([0.5, 1.0, 1.5])
    assert results[22]["history"] == {"frames": 1, "reset_reason": reasons[22], "ages_s": []}


def test_each_source_gives_the_boxes_of_a_run_of_its_own(tiny_bundle, sources, whole, tmp_path):
    notes: list[str] = []
    jobs.run(tiny_bundle, sources[1], tmp_path / "alone", history_step_s=0.5, notify=notes.append)
    assert not any("--history-step" in note for note in notes)
    alone = [result["boxes"] for result in read_results(tmp_path / "alone" / "results.jsonl")]
    assert alone == [result["boxes"] for result in read_results(whole / "results.jsonl")][FAST_STEPS + 4 :]


@pytest.mark.parametrize("kept", [12, 18, 19, 22, 26])
def test_a_run_resumes_inside_and_between_scenes_and_sources(tiny_bundle, sources, whole, tmp_path, kept):
    """Frame 18 was skipped; frames 19 and 22 begin a scene."""
    out = tmp_path / "out"
    shutil.copytree(whole, out)
    (out / "results_nusc.json").unlink()
    lines = (out / "results.jsonl").read_bytes().splitlines(keepends=True)
    (out / "results.jsonl").write_bytes(
        b"".join(lines[:kept]) + lines[kept][:99] if kept < len(lines) else b"".join(lines)
    )
    for index in range(kept, len(lines)):
        for path in [*(out / "maps").glob(f"{index:06d}_*"), *(out / "pictures").glob(f"{index:06d}*")]:
            path.unlink()
    assert jobs.run(tiny_bundle, sources, out, **OPTIONS, resume=True).frames == len(lines)
    assert contents(out) == contents(whole)


OTHER_SETTINGS = {
    "another order of the sources": ({}, [1, 0], "the run began with source"),
    "one source less": ({}, [0], "the run began with source"),
    "another step": ({"history_step_s": 1.0}, [0, 1], "the run began with history_step_s 0.5; got 1.0"),
    "no step": ({"history_step_s": None}, [0, 1], "the run began with history_step_s 0.5; got 'newest frames'"),
}


@pytest.mark.parametrize("name", OTHER_SETTINGS)
def test_a_run_is_not_resumed_with_other_sources_or_another_step(tiny_bundle, sources, whole, name):
    changes, order, words = OTHER_SETTINGS[name]
    with pytest.raises(UsageError, match=words):
        jobs.run(tiny_bundle, [sources[index] for index in order], whole, **OPTIONS | changes, resume=True)


def test_a_step_that_is_not_valid_is_refused_before_anything_is_written(tiny_bundle, sources, tmp_path):
    with pytest.raises(UsageError, match=r"--history-step: expected 0\.01 to 2 s"):
        jobs.run(tiny_bundle, sources, tmp_path / "out", history_step_s=3.0)
    assert not (tmp_path / "out").exists()


def test_the_settings_of_a_run_name_all_sources(whole, sources):
    settings = json.loads((whole / "run.json").read_text())
    assert settings["source"].count("sha256") == 2
    assert settings["history_step_s"] == 0.5


def test_an_empty_list_of_sources_is_refused(tiny_bundle, tmp_path):
    with pytest.raises(UsageError, match="expected at least one source"):
        jobs.run(tiny_bundle, [], tmp_path / "out")


def test_eval_uses_the_step_as_run_does(tiny_bundle, sources, whole, tmp_path):
    """The scores of the bundle with the step are those of the submission of the run with the step."""
    with_step = evaluate_bundle(tiny_bundle, sources, history_step_s=0.5).to_dict()
    notes: list[str] = []
    newest = evaluate_bundle(tiny_bundle, sources, notify=notes.append).to_dict()
    assert sum("--history-step 0.5 keeps" in note for note in notes) == 2  # one per source
    assert (with_step["history_step_s"], newest["history_step_s"]) == (0.5, None)
    submitted = jobs.evaluate_submission(whole / "results_nusc.json", sources).to_dict()
    assert with_step["classes"] == submitted["classes"]
    assert with_step["classes"] != newest["classes"]


def test_eval_refuses_a_step_for_the_model_in_pytorch(tiny_bundle, sources, tmp_path):
    with pytest.raises(UsageError, match="--history-step: expected only without --eager"):
        evaluate_bundle(tiny_bundle, sources, history_step_s=0.5, eager=True, weights=tmp_path / "w.pth")
