"""`duospacenet train` from end to end: what it writes, how it goes on, and what it refuses before it begins."""

import errno
import importlib
import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from duospacenet.cli import train as train_command
from duospacenet.cli.main import run_app
from duospacenet.data.scene_writer import write_scene
from duospacenet.jobs.models import load_weights
from duospacenet.jobs.output_folder import held
from duospacenet.model import DuoSpaceNet, randomise
from duospacenet.runtime.errors import InputError
from duospacenet.runtime.frame import GroundTruth
from duospacenet.training import Settings, TrainingFolder
from duospacenet.training import clips as training_clips
from duospacenet.training.loss_curves import write_loss_curves
from duospacenet.weights import save_checkpoint
from duospacenet.weights.provenance import hash_weights
from tests.helpers.processes import start, wait_for
from tests.helpers.trainings import TINY, new_trainer, synthetic_frames

FEW = ["train", "--preset", "tiny", "--steps", "4", "--batch-size", "1", "--frames-per-clip", "2"]
FEW += ["--warmup-steps", "1", "--no-bf16", "--workers", "0"]
WRITTEN = {"training.json", "checkpoint.pt", "log.jsonl", "weights.safetensors", "losses.png"}


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A scene folder of three frames."""
    folder = tmp_path_factory.mktemp("scenes") / "scene"
    write_scene(folder, synthetic_frames(1, 3))
    return folder


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """Weights to begin with, so that no anchors are looked for."""
    path = tmp_path_factory.mktemp("weights") / "tiny.safetensors"
    save_checkpoint(path, randomise(DuoSpaceNet(TINY), 0))
    return path


@pytest.fixture
def few(scene, weights):
    """A short training's arguments but for its folder."""
    return [*FEW, "--source", str(scene), "--weights", str(weights)]


def refused(capfd, *arguments):
    """The exit code and the message, which is a line without a traceback."""
    code = run_app(list(map(str, arguments)))
    said = capfd.readouterr().err
    assert "Traceback" not in said
    assert "internal error" not in said
    return code, said


# --- A training ---------------------------------------------------------------------------------------------------


def test_a_training_writes_its_folder_and_says_where_the_weights_are(few, tmp_path, capfd):
    assert run_app([*few, "--out", str(tmp_path / "new" / "out"), "--json"]) == 0
    printed = capfd.readouterr()
    out = tmp_path / "new" / "out"
    assert {path.name for path in out.iterdir()} == WRITTEN
    log = [json.loads(line) for line in (out / "log.jsonl").read_text().splitlines()]
    assert [line["step"] for line in log] == [0, 1, 2, 3]
    summary = json.loads(printed.out)
    assert summary["weights"] == str(out / "weights.safetensors")
    assert summary["steps"] == 4
    assert summary["loss"] == pytest.approx(sum(line["total"] for line in log) / 4)
    assert json.loads((out / "training.json").read_text())["settings"]["bf16"] is False


def test_a_training_begins_with_what_a_pre_training_gave(few, scene, tmp_path, capfd):
    """README's two commands: the weights of the first are whole, and the second's record names them."""
    first, second = tmp_path / "first", tmp_path / "second"
    assert run_app([*few, "--pretraining", "--out", str(first)]) == 0
    weights = first / "weights.safetensors"
    again = [*FEW, "--source", str(scene), "--weights", str(weights), "--seed", "1", "--steps", "2"]
    assert run_app([*again, "--out", str(second)]) == 0
    model = DuoSpaceNet(TINY)
    model.load_state_dict(load_file(weights))
    assert json.loads((second / "training.json").read_text())["start"] == hash_weights(model)
    assert "internal error" not in capfd.readouterr().err


def test_without_a_source_or_weights_it_draws_both(tmp_path, monkeypatch, capfd):
    """With anchors among the objects of the first frames; fewer of them here than it takes for a training."""
    monkeypatch.setattr(training_clips, "ANCHOR_FRAMES", 4)
    assert run_app([*FEW, "--steps", "1", "--out", str(tmp_path / "out")]) == 0
    assert "wrote" in capfd.readouterr().out
    record = json.loads((tmp_path / "out" / "training.json").read_text())
    assert re.fullmatch(r"synthetic world \d+, clips of 2 frames from seed 1000000000000000000", record["data"])
    DuoSpaceNet(TINY).load_state_dict(load_file(tmp_path / "out" / "weights.safetensors"))


def test_what_weights_lack_is_drawn_and_the_queries_stand_among_the_objects(scene, tmp_path, capfd):
    """An image encoder alone, as a pre-training elsewhere would give it. The steps are too small to be seen."""
    encoder = randomise(DuoSpaceNet(TINY), 5).image_encoder.state_dict()
    save_file({f"image_encoder.{name}": tensor for name, tensor in encoder.items()}, tmp_path / "encoder.safetensors")
    begin = [*FEW, "--source", str(scene), "--weights", str(tmp_path / "encoder.safetensors"), "--steps", "1"]
    assert run_app([*begin, "--out", str(tmp_path / "refused")]) == 4
    assert not (tmp_path / "refused").exists()
    allowed = ["--allow-missing", "*", "--learning-rate", "1e-12", "--out", str(tmp_path / "out")]
    capfd.readouterr()
    assert run_app([*begin, *allowed]) == 0
    assert re.search(r"encoder\.safetensors: \d+ tensors matched, \d+ allowed to be missing", capfd.readouterr().err)
    learned = load_file(tmp_path / "out" / "weights.safetensors")
    for name, _ in DuoSpaceNet(TINY).image_encoder.named_parameters():
        torch.testing.assert_close(learned[f"image_encoder.{name}"], encoder[name], msg=name)
    centres = torch.cat([torch.from_numpy(frame.ground_truth.boxes[:, :3]) for frame in synthetic_frames(1, 3)]).float()
    places = learned["queries.pose"][:, :3]
    assert (places >= centres.amin(dim=0) - 1e-3).all()
    assert (places <= centres.amax(dim=0) + 1e-3).all()
    assert places[:, 2].std() > 0.1  # spread over the range without anchors, all are a metre above the ground
    assert run_app([*begin, *allowed, "--resume"]) == 0  # the same was drawn again: the hash of the start is


def test_what_a_checkpoints_names_cannot_tell_is_noted(few, tmp_path, capfd, monkeypatch):
    """As `export` does: names cannot tell how a torchvision ResNet was trained."""
    note = "how it was trained is assumed"
    monkeypatch.setattr(train_command, "load_weights", lambda *given: load_weights(*given).with_notes([note]))
    assert run_app([*few, "--out", str(tmp_path / "out")]) == 0
    assert f"note: {note}" in capfd.readouterr().err.splitlines()


def test_two_trainings_do_not_write_into_one_folder(few, tmp_path, capfd):
    out = tmp_path / "out"
    assert run_app([*few, "--out", str(out)]) == 0
    before = {path.name: path.stat().st_mtime_ns for path in out.iterdir()}
    with held(out):
        code, said = refused(capfd, *few, "--out", out, "--resume")
    assert code == 5
    assert "another run is writing there" in said
    assert {path.name: path.stat().st_mtime_ns for path in out.iterdir()} == before
    new = tmp_path / "new"
    new.mkdir()
    with held(new):
        code, said = refused(capfd, *few, "--out", new)
    assert code == 5
    assert "another run is writing there" in said
    assert list(new.iterdir()) == []


def test_of_two_trainings_that_begin_at_once_the_later_one_is_refused(few, tmp_path, capfd, monkeypatch):
    """The other one has held the folder, and is done, when this one gets it."""
    out = tmp_path / "out"

    @contextmanager
    def held_late(folder):
        (folder / "training.json").write_text("the other's")
        with held(folder):
            yield

    monkeypatch.setattr(train_command, "held", held_late)
    code, said = refused(capfd, *few, "--out", out)
    assert code == 5
    assert "an earlier training wrote it" in said
    assert [path.read_text() for path in out.iterdir()] == ["the other's"]


def test_a_folder_that_cannot_be_locked_is_not_said_to_be_another_runs(few, tmp_path, capfd, monkeypatch):
    def no_locks(*_):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr("fcntl.flock", no_locks)
    code, said = refused(capfd, *few, "--out", tmp_path / "out")
    assert code == 5
    assert "cannot be locked (No locks available)" in said


def test_a_broken_off_training_goes_on_with_resume_as_if_nothing_had_happened(few, tmp_path, monkeypatch, capfd):
    """Ctrl-C comes after the first checkpoint, while the second group of drives is at work."""
    save_all = [*few, "--save-every", "1"]
    record = TrainingFolder.append_log

    def interrupted(folder, steps):
        record(folder, steps)
        if steps[0].number > 0:
            raise KeyboardInterrupt

    assert run_app([*save_all, "--out", str(tmp_path / "whole")]) == 0
    monkeypatch.setattr(TrainingFolder, "append_log", interrupted)
    assert run_app([*save_all, "--out", str(tmp_path / "parts")]) == 130
    assert "interrupted; finished results are on disk" in capfd.readouterr().err
    write_loss_curves([], tmp_path / "nothing.png")
    assert (tmp_path / "parts" / "losses.png").read_bytes() != (tmp_path / "nothing.png").read_bytes()
    monkeypatch.undo()
    assert run_app([*save_all, "--out", str(tmp_path / "parts"), "--resume"]) == 0
    parts, whole = tmp_path / "parts", tmp_path / "whole"
    for name in ("log.jsonl", "training.json"):
        assert (parts / name).read_bytes() == (whole / name).read_bytes(), name
    ours, expected = (load_file(folder / "weights.safetensors") for folder in (parts, whole))
    assert [name for name, tensor in expected.items() if not torch.equal(tensor, ours[name])] == []


@pytest.mark.parametrize("line", ["nonsense\n", '{"step": 9}\n'])
def test_what_broke_a_training_off_is_told_though_its_curves_cannot_be_drawn(few, tmp_path, monkeypatch, capfd, line):
    record = TrainingFolder.append_log

    def fails(folder, steps):
        record(folder, steps)
        with (folder.path / "log.jsonl").open("a") as file:
            file.write(line)
        raise InputError("the frames ended")

    monkeypatch.setattr(TrainingFolder, "append_log", fails)
    code, said = refused(capfd, *few, "--out", tmp_path / "out")
    assert code == 3
    assert said.splitlines()[-1] == "error: the frames ended"
    assert not (tmp_path / "out" / "losses.png").exists()


def test_a_training_that_is_done_can_be_resumed_without_harm(few, tmp_path, capfd):
    out = tmp_path / "out"
    assert run_app([*few, "--out", str(out)]) == 0
    before = (out / "weights.safetensors").read_bytes()
    assert run_app([*few, "--out", str(out), "--resume", "--json"]) == 0
    assert json.loads(capfd.readouterr().out.splitlines()[-1])["loss"] is None
    assert (out / "weights.safetensors").read_bytes() == before


def test_ctrl_c_ends_it_and_leaves_a_whole_checkpoint(few, tmp_path):
    """A real process; as at a terminal, the signal reaches its worker as well."""
    out = tmp_path / "out"
    arguments = [*few, "--out", out, "--steps", "100000", "--save-every", "1", "--workers", "1"]
    process = start(arguments, process_group=0)
    assert_interruptible(process, (out / "checkpoint.pt").exists)
    assert not [path for path in out.iterdir() if path.name.startswith(".")]
    settings = Settings.from_dict(json.loads((out / "training.json").read_text())["settings"])
    trainer = new_trainer(settings)
    trainer.load_state_dict(torch.load(out / "checkpoint.pt", weights_only=True))
    assert trainer.step >= 1


def test_ctrl_c_while_workers_start_ends_it_too(few, tmp_path):
    """The worker is still importing then."""
    process = start([*few, "--out", tmp_path / "out", "--steps", "100000", "--workers", "1"], process_group=0)
    assert_interruptible(process, lambda: is_importing_torch(process.pid))


def assert_interruptible(process: subprocess.Popen, begun: Callable[[], bool]) -> None:
    """Ctrl-C to the whole process group once `begun` holds: it ends with 130, and says what is kept."""
    try:
        wait_for(lambda: process.poll() is not None or begun())
        os.killpg(process.pid, signal.SIGINT)
        _, said = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 130, said
    assert "interrupted; finished results are on disk" in said.splitlines()


def is_importing_torch(parent: int) -> bool:
    """Whether a child of this process has begun to load torch's libraries (Linux)."""
    children = Path(f"/proc/{parent}/task/{parent}/children").read_text().split()
    return any("libtorch" in Path(f"/proc/{child}/maps").read_text() for child in children)


# --- What is refused ----------------------------------------------------------------------------------------------


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
        (["--device", "tpu"], "--device: expected auto, cpu or cuda; got 'tpu'"),
        (["--preset", "huge"], "--preset: expected one of "),
        (["--workers", "-1"], "--workers"),
        (["--save-every", "0"], "--save-every"),
        (["--resume"], "--resume: expected training.json in "),
        (["--denoising", "-1"], "--denoising: "),
        (["--pretraining", "--no-pv-supervision"], "--pv-supervision: expected True with pretraining"),
    ],
)
def test_words_that_are_off_end_with_2_and_name_the_option(few, tmp_path, capfd, options, words):
    code, said = refused(capfd, *few, "--out", tmp_path / "out", *options)
    assert code == 2
    assert words in said
    assert not (tmp_path / "out").exists()


def test_what_may_be_missing_is_refused_where_all_is_drawn(tmp_path, capfd):
    code, said = refused(capfd, *FEW, "--allow-missing", "*", "--out", tmp_path / "out")
    assert code == 2
    assert "--allow-missing: expected with --weights FILE; got none" in said
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--learning-rate", "0.01"], "was started with learning_rate 0.0004; got 0.01"),
        (["--steps", "5"], "was started with steps 4; got 5"),
        (["--seed", "1"], "was started with seed 0; got 1"),
        (["--no-pv-supervision"], "was started with pv_supervision True; got False"),
        (["--no-bev-supervision"], "was started with bev_supervision True; got False"),
        (["--denoising", "2"], "was started with denoising 1; got 2"),
        (["--pretraining"], "was started with pretraining False; got True"),
    ],
)
def test_a_training_is_not_resumed_with_other_settings(few, tmp_path, capfd, options, words):
    out = tmp_path / "out"
    assert run_app([*few, "--out", str(out)]) == 0
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    code, said = refused(capfd, *few, "--out", out, "--resume", *options)
    assert code == 2
    assert words in said
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before


def test_a_folder_with_a_training_or_with_somebodys_weights_is_left_alone(few, tmp_path, capfd):
    for name, words in (("training.json", "an earlier training wrote it"), ("weights.safetensors", "no training is")):
        out = tmp_path / name.partition(".")[0]
        out.mkdir()
        (out / name).write_text("mine")
        code, said = refused(capfd, *few, "--out", out)
        assert code == 5
        assert words in said
        assert [path.read_text() for path in out.iterdir()] == ["mine"]


@pytest.mark.parametrize(("package", "extra"), [("scipy", "train"), ("matplotlib", "viz")])
def test_a_package_that_is_missing_is_told_before_anything_is_written(
    few, tmp_path, capfd, monkeypatch, package, extra
):
    for name in [name for name in sys.modules if name.startswith("duospacenet.training")]:
        monkeypatch.delitem(sys.modules, name)
    for name in [name for name in sys.modules if name.partition(".")[0] == package]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, package, None)
    monkeypatch.delattr(importlib.import_module("duospacenet"), "training", raising=False)
    code, said = refused(capfd, *few, "--out", tmp_path / "out")
    assert code == 6
    assert package in said
    assert f"pip install 'duospacenet[{extra}]'" in said
    assert not (tmp_path / "out").exists()


def without(frame, *names):
    """The frame with a truth that lacks these maps; without names, with none at all."""
    maps = {name: mask for name, mask in frame.ground_truth.maps.items() if name not in names}
    return replace(
        frame, ground_truth=GroundTruth(frame.ground_truth.boxes, frame.ground_truth.classes, maps) if names else None
    )


def with_maps_alone(frame):
    return replace(frame, ground_truth=GroundTruth(np.zeros((0, 9)), (), frame.ground_truth.maps, has_boxes=False))


@pytest.mark.parametrize("unknown", [without, with_maps_alone])
def test_a_source_that_does_not_say_what_stands_in_a_later_frame_is_refused_before_it_begins(
    few, tmp_path, capfd, unknown
):
    """No boxes are something else than none there."""
    *known, last = synthetic_frames(1, 3)
    write_scene(tmp_path / "scene", [*known, unknown(last)])
    code, said = refused(capfd, *few, "--source", tmp_path / "scene", "--out", tmp_path / "out")
    assert code == 3
    assert (
        "error: frame synthetic-1-000002: expected ground-truth boxes; got none. Train on a source with ground truth."
        in said
    )
    assert not (tmp_path / "out").exists()


def test_a_source_without_a_map_that_is_to_be_learned_is_refused(few, tmp_path, capfd):
    write_scene(tmp_path / "scene", [without(frame, "lane_boundary") for frame in synthetic_frames(1, 2)])
    code, said = refused(capfd, *few, "--source", tmp_path / "scene", "--out", tmp_path / "out")
    assert code == 3
    assert re.search(
        r"error: frame synthetic-1-00000\d: expected a ground-truth map 'lane_boundary' of 16x16 cells", said
    )
    assert not (tmp_path / "out").exists()


def test_a_drawn_drive_can_be_a_source_with_maps_of_the_models_grid(weights, tmp_path):
    arguments = [*FEW, "--source", "synthetic:1:2", "--weights", str(weights), "--steps", "1"]
    assert run_app([*arguments, "--out", str(tmp_path / "out")]) == 0


def test_a_pre_training_wants_no_maps_for_it_learns_none(few, tmp_path):
    write_scene(
        tmp_path / "scene", [without(frame, "lane_boundary", "drivable_area") for frame in synthetic_frames(1, 2)]
    )
    assert run_app([*few, "--source", str(tmp_path / "scene"), "--out", str(tmp_path / "out"), "--pretraining"]) == 0


def test_a_later_frame_that_cannot_be_learned_from_is_told_as_clearly_by_a_worker(few, tmp_path, capfd):
    first, second = synthetic_frames(1, 2)
    write_scene(tmp_path / "scene", [first, without(second, "drivable_area")])
    code, said = refused(capfd, *few, "--source", tmp_path / "scene", "--out", tmp_path / "out", "--workers", "1")
    assert code == 3
    assert said.splitlines()[-1].startswith(
        "error: frame synthetic-1-000001: expected a ground-truth map 'drivable_area' of 16x16 cells"
    )
    assert not (tmp_path / "out" / "losses.png").exists()  # there were no losses
