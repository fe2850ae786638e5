"""`duospacenet train --recipe`, `--set` and `--epochs`, from end to end."""

import json
from dataclasses import replace

import pytest

from duospacenet.cli.main import run_app
from duospacenet.training.recipe import read_recipe
from tests.helpers.train_command import TRAIN_TINY, run_refused, with_options

PAPER = ["train", "--preset", "tiny", "--recipe", "paper", "--workers", "0", "--amp", "off"]


def recorded(out):
    """The settings in the record of a training."""
    return json.loads((out / "training.json").read_text())["settings"]


def test_a_training_with_the_papers_recipe_records_its_settings_and_the_steps_of_its_epochs(tmp_path):
    """Three frames in batches of two: two steps per epoch."""
    out = tmp_path / "out"
    options = ["--source", "synthetic:1:3", "--epochs", "2", "--batch-size", "2", "--set", "dropout=0.2"]
    assert run_app([*PAPER, *options, "--set", "past_frames=1", "--out", str(out)]) == 0
    changes = {"steps": 4, "epochs": 2, "batch_size": 2, "dropout": 0.2, "past_frames": 1, "amp": "off"}
    assert recorded(out) == replace(read_recipe("paper"), **changes).to_dict()
    steps = [line for line in map(json.loads, (out / "log.jsonl").read_text().splitlines()) if "total" in line]
    assert len(steps) == 4


def test_a_file_of_the_user_is_a_recipe(tmp_path):
    recipe, out = tmp_path / "mine.toml", tmp_path / "out"
    recipe.write_text("steps = 1\nbatch_size = 1\nframes_per_clip = 2\namp = 'off'\ndenoising = 0\n")
    options = ["--source", "synthetic:1:2", "--workers", "0", "--seed", "3", "--out", str(out)]
    assert run_app(["train", "--preset", "tiny", "--recipe", str(recipe), *options]) == 0
    settings = recorded(out)
    assert (settings["recipe"], settings["denoising"], settings["seed"]) == ("mine.toml", 0, 3)


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (["--recipe", "papr"], 2, "--recipe: expected cpu, paper or a .toml file; got 'papr'"),
        (["--recipe", "none.toml"], 3, "none.toml: expected a file; got no such file"),
        (["--recipe", "wrong.toml"], 3, "wrong.toml: setting dropout: Input should be less than 1; got 3"),
        (["--set", "dropout"], 2, "--set: expected NAME=VALUE; got 'dropout'"),
        (["--set", "dropout=2"], 2, "--set dropout: Input should be less than 1; got 2"),
        (["--set", "step=2"], 2, "--set: expected the name of a setting; got 'step'. Did you mean steps?"),
        (["--set", "seed=2", "--seed", "1"], 2, "--set seed: expected at most once; got --seed too"),
        (["--set", "yaw_free_classes=['cone']"], 2, "got 'cone'"),
        (["--epochs", "2"], 2, "expected either --steps or --epochs; got both"),
        (["--epochs", "0"], 2, "expected either --steps or --epochs; got both"),
        (["--tasks", "boxes"], 2, "--tasks: Input should be 'both', 'detection' or 'maps'; got 'boxes'"),
        (["--amp", "half"], 2, "--amp: Input should be 'off', 'bfloat16' or 'float16'; got 'half'"),
    ],
)
def test_a_wrong_recipe_or_value_is_refused_before_anything_is_written(
    tmp_path, monkeypatch, capfd, options, code, words
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "wrong.toml").write_text("dropout = 3")
    got, message = run_refused(capfd, *with_options(TRAIN_TINY, "--out", "out", *options))
    assert got == code
    assert words in " ".join(message.split())
    assert not (tmp_path / "out").exists()


def test_epochs_of_synthetic_scenes_are_refused(tmp_path, capfd):
    code, message = run_refused(capfd, *PAPER, "--out", tmp_path / "out")
    assert code == 2
    assert "recipe paper: expected --source for a training of 24 epochs; got none" in message
    assert not (tmp_path / "out").exists()
