"""`duospacenet train`: arguments, folders and sources that are refused before anything is written."""

import importlib
import sys
from dataclasses import replace

import numpy as np
import pytest

from duospacenet.cli.main import run_app
from duospacenet.data.scene_writer import write_scene
from duospacenet.jobs.config_file import config_to_json
from tests.helpers.scene_files import copy_tree
from tests.helpers.train_command import TRAIN_TINY, run_refused, with_options
from tests.helpers.trainings import TINY, synthetic_frames


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--steps", "0"], "--steps: Input should be greater than 0; got 0"),
        (["--seed", "1000"], "--seed: Input should be less than 1000; got 1000"),
        (["--seed", "-1"], "--seed: "),
        (["--learning-rate", "nan"], "--learning-rate: "),
        (["--backbone-learning-rate", "0"], "--backbone-learning-rate: Input should be greater than 0; got 0"),
        (["--grid-mask", "1.5"], "--grid-mask: "),
        (["--batch-size", "0"], "--batch-size: "),
        (["--auxiliary-matches", "0"], "--auxiliary-matches: "),
        (["--device", "tpu"], "--device: expected auto, cpu, cuda or cuda:N; got 'tpu'"),
        (["--preset", "huge"], "--preset: expected one of "),
        (["--workers", "-1"], "--workers"),
        (["--save-every", "0"], "--save-every"),
        (["--resume"], "--resume: expected training.json in "),
        (["--denoising", "-1"], "--denoising: "),
        (
            ["--set", "past_frames=4"],
            "past_frames: expected at most 3, the past frames in the temporal",
        ),
        (["--set", "class_balanced=true", "--tasks", "maps"], "class_balanced: expected detection to be trained"),
        (["--pretraining", "--tasks", "maps"], "--pretraining: expected with --tasks both or detection"),
        (["--pretraining", "--no-pv-supervision"], "--pv-supervision: expected True with pretraining"),
    ],
)
def test_an_invalid_value_ends_with_2_and_names_the_option(train_tiny, tmp_path, capfd, options, words):
    code, message = run_refused(capfd, *with_options(train_tiny, "--out", tmp_path / "out", *options))
    assert code == 2
    assert words in message
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--set", "class_balanced=true"], "class_balanced: expected --source with it; got none"),
        (["--tasks", "maps", "--config", "CONFIG"], "--tasks: expected detection for mine, which has no map classes"),
    ],
)
def test_settings_that_do_not_fit_the_model_or_the_data_are_refused(tmp_path, capfd, options, words):
    (tmp_path / "mine.json").write_text(config_to_json(replace(TINY, preset="mine", map_classes=())))
    given = [str(tmp_path / "mine.json") if option == "CONFIG" else option for option in options]
    train = [word for word in TRAIN_TINY if "--config" not in options or word not in ("--preset", "tiny")]
    code, message = run_refused(capfd, *train, *given, "--out", tmp_path / "out")
    assert code == 2
    assert words in message
    assert not (tmp_path / "out").exists()


def test_allow_missing_is_refused_without_weights(tmp_path, capfd):
    code, message = run_refused(capfd, *TRAIN_TINY, "--allow-missing", "*", "--out", tmp_path / "out")
    assert code == 2
    assert "--allow-missing: expected only with --weights FILE; got none" in message
    assert not (tmp_path / "out").exists()


@pytest.fixture(scope="module")
def finished(training_scene, initial_weights, tmp_path_factory):
    """The folder of a finished training. Tests that resume it take a copy."""
    out = tmp_path_factory.mktemp("finished") / "out"
    source = ["--source", str(training_scene), "--weights", str(initial_weights)]
    assert run_app([*TRAIN_TINY, *source, "--out", str(out)]) == 0
    return out


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--learning-rate", "0.01"], "the training began with learning_rate 0.0004; got 0.01"),
        (
            ["--steps", "3"],
            "the training has steps 4; got 3. A training may be resumed with more steps, not with fewer",
        ),
        (["--seed", "1"], "the training began with seed 0; got 1"),
        (["--no-pv-supervision"], "the training began with pv_supervision True; got False"),
        (["--no-bev-supervision"], "the training began with bev_supervision True; got False"),
        (["--denoising", "2"], "the training began with denoising 1; got 2"),
        (["--pretraining"], "the training began with pretraining False; got True"),
    ],
)
def test_a_training_is_not_resumed_with_other_settings(train_tiny, finished, tmp_path, capfd, options, words):
    out = copy_tree(finished, tmp_path / "out")
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    code, message = run_refused(capfd, *with_options(train_tiny, "--out", out, "--resume", *options))
    assert code == 2
    assert words in message
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before


def test_the_folder_of_another_training_or_with_other_weights_is_refused_and_unchanged(train_tiny, tmp_path, capfd):
    for name, words in (
        ("training.json", "an earlier training wrote this folder"),
        ("weights.safetensors", "no training.json shows"),
    ):
        out = tmp_path / name.partition(".")[0]
        out.mkdir()
        (out / name).write_text("mine")
        code, message = run_refused(capfd, *train_tiny, "--out", out)
        assert code == 5
        assert words in message
        assert [path.read_text() for path in out.iterdir()] == ["mine"]


@pytest.mark.parametrize(("package", "extra"), [("scipy", "train"), ("matplotlib", "viz")])
def test_a_missing_package_is_reported_before_anything_is_written(
    train_tiny, tmp_path, capfd, monkeypatch, package, extra
):
    for name in [name for name in sys.modules if name.startswith("duospacenet.training")]:
        monkeypatch.delitem(sys.modules, name)
    for name in [name for name in sys.modules if name.partition(".")[0] == package]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, package, None)
    monkeypatch.delattr(importlib.import_module("duospacenet"), "training", raising=False)
    code, message = run_refused(capfd, *train_tiny, "--out", tmp_path / "out")
    assert code == 6
    assert package in message
    assert f"pip install 'duospacenet[{extra}]'" in message
    assert not (tmp_path / "out").exists()


def without_maps(frame):
    return replace(frame, ground_truth=replace(frame.ground_truth, maps={}))


def without_any(frame):
    return replace(frame, ground_truth=None)


def without_boxes(frame):
    unknown = {"boxes": np.zeros((0, 9)), "classes": (), "num_points": None, "attributes": None}
    return replace(frame, ground_truth=replace(frame.ground_truth, **unknown, has_boxes=False))


@pytest.mark.parametrize(
    ("tasks", "remove", "words"),
    [
        (
            "both",
            lambda frame: replace(frame, ground_truth=None),
            "boxes or masks of drivable_area or lane_boundary in",
        ),
        ("detection", without_boxes, "boxes in"),
        ("maps", without_maps, "masks of drivable_area or lane_boundary in"),
    ],
)
def test_a_source_without_anything_to_train_on_is_refused_by_its_name(
    train_tiny, tmp_path, capfd, tasks, remove, words
):
    write_scene(tmp_path / "second", map(remove, synthetic_frames(1, 2)))
    train = [*train_tiny, "--source", tmp_path / "second", "--tasks", tasks, "--out", tmp_path / "out"]
    code, message = run_refused(capfd, *train)
    assert code == 3
    expected = f"{tmp_path / 'second'}: expected ground-truth {words} at least one frame; got none in 2 frames. Leave"
    assert expected in message
    assert not (tmp_path / "out").exists()


def test_a_synthetic_source_has_maps_on_the_models_grid(initial_weights, tmp_path):
    arguments = with_options(TRAIN_TINY, "--source", "synthetic:1:2", "--weights", str(initial_weights), "--steps", "1")
    assert run_app([*arguments, "--out", str(tmp_path / "out")]) == 0


def test_a_pretraining_needs_no_maps(train_tiny, tmp_path):
    write_scene(tmp_path / "scene", map(without_maps, synthetic_frames(1, 2)))
    assert (
        run_app(with_options(train_tiny, "--source", tmp_path / "scene", "--out", tmp_path / "out", "--pretraining"))
        == 0
    )


def test_a_worker_reports_an_invalid_later_frame_as_clearly(train_tiny, tmp_path, capfd):
    first, second = synthetic_frames(1, 2)
    more = {"CAM_ROOF": second.cameras["CAM_FRONT"]}, {"CAM_ROOF": second.images["CAM_FRONT"]}
    second = replace(second, cameras=second.cameras | more[0], images={**second.images, **more[1]})
    write_scene(tmp_path / "scene", [first, second])
    code, message = run_refused(
        capfd, *with_options(train_tiny, "--source", tmp_path / "scene", "--out", tmp_path / "out", "--workers", "1")
    )
    assert code == 3
    assert message.splitlines()[-1].startswith("error: frame synthetic-1-000001: cameras: expected 1 to 6")
    assert not (tmp_path / "out" / "losses.png").exists()  # no step was done


def renamed(frame, class_name):
    """The frame with all its boxes under another name."""
    truth = frame.ground_truth
    return replace(frame, ground_truth=replace(truth, classes=(class_name,) * len(truth.classes)))


def test_unknown_class_names_are_refused_before_anything_is_written(train_tiny, tmp_path, capfd):
    first, second = synthetic_frames(1, 2)
    write_scene(tmp_path / "scene", [first, renamed(second, "Car")])
    code, message = run_refused(
        capfd, *with_options(train_tiny, "--source", tmp_path / "scene", "--out", tmp_path / "out")
    )
    assert code == 3
    assert f"scene.json: expected class names of the model ({', '.join(TINY.classes)}), or category" in message
    assert f"got 'Car' ({len(second.ground_truth.boxes)} boxes). Rename them, or add to scene.json" in message
    assert not (tmp_path / "out").exists()


def test_a_source_without_a_box_to_train_on_is_refused(train_tiny, tmp_path, capfd):
    frames = [renamed(frame, "movable_object.debris") for frame in synthetic_frames(1, 2)]
    num_boxes = sum(len(frame.ground_truth.boxes) for frame in frames)
    write_scene(tmp_path / "scene", frames)
    code, message = run_refused(
        capfd, *with_options(train_tiny, "--source", tmp_path / "scene", "--out", tmp_path / "out")
    )
    assert code == 3
    assert f"got none in 2 frames; left out {num_boxes} boxes of other classes: movable_object.debris" in message
    assert not (tmp_path / "out").exists()
