"""Tests of recipes: the built-in files, files of a user, and other values for some of their settings."""

import re
import tomllib
from dataclasses import fields

import pytest

from duospacenet.runtime.errors import InputError, UsageError
from duospacenet.training import Settings
from duospacenet.training.recipe import BUILT_IN, FOLDER, override, parse_assignments, read_recipe

LEFT_OUT = {"cpu": {"recipe", "epochs", "past_frames"}, "paper": {"recipe", "steps", "past_frames"}}


@pytest.mark.parametrize("name", BUILT_IN)
def test_a_built_in_recipe_states_every_setting(name):
    stated = set(tomllib.loads((FOLDER / f"{name}.toml").read_text()))
    assert stated == {field.name for field in fields(Settings)} - LEFT_OUT[name]


def test_every_line_of_the_papers_recipe_has_its_source():
    lines = [line for line in (FOLDER / "paper.toml").read_text().splitlines() if line and not line.startswith("#")]
    assert len(lines) == len(fields(Settings)) - len(LEFT_OUT["paper"])
    for line in lines:
        assert re.search(r"# (paper|Sparse4D|Sparse4D, DETR3D|Sparse4D v2 and v3|ours)\b", line), line


def test_the_default_settings_are_the_recipe_for_a_cpu():
    assert read_recipe("cpu") == Settings()


def test_the_papers_recipe_has_the_values_of_the_paper_and_of_sparse4d_v1():
    """Each value copied from the paper's supplement and from the configuration of Sparse4D v1, not from the file."""
    paper = read_recipe("paper")
    assert (paper.epochs, paper.batch_size) == (24, 8)
    assert (paper.learning_rate, paper.backbone_learning_rate, paper.weight_decay) == (2e-4, 2e-5, 0.01)
    assert (paper.warmup_steps, paper.warmup_start, paper.final_learning_rate) == (500, 1 / 3, 1e-3)
    assert (paper.clip_norm, paper.dropout, paper.ema_decay) == (35, 0.1, 0)
    assert (paper.frozen_stages, paper.backbone_norm_eval) == (1, True)
    assert (paper.history, paper.history_strides, paper.past_frames) == ("windows", (1, 2), None)
    assert (paper.grid_mask, paper.grid_mask_ramp) == (0.7, False)
    assert (paper.photometric, paper.geometric, paper.class_balanced) == (False, False, False)
    assert (paper.class_weight, paper.box_weight, paper.box_loss_weights) == (2, 0.25, (2,) * 3 + (1,) * 7)
    assert (paper.match_class_cost, paper.match_box_cost, paper.match_box_weights) == (2, 0.25, (2,) * 3 + (1,) * 7)
    assert (paper.box_loss_min_score, paper.yaw_free_classes) == (0.05, ("traffic_cone",))
    assert (paper.loss_average, paper.auxiliary_matches) == ("batch", 1)
    assert (paper.content_init, paper.anchor_size) == ("xavier", "mean")
    assert not (paper.pretraining or paper.denoising or paper.pv_supervision or paper.bev_supervision)


def test_a_file_leaves_the_other_settings_to_the_recipe_for_a_cpu(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text("epochs = 3\nlearning_rate = 1e-3\nhistory_strides = [1, 2]\n")
    expected = Settings(recipe="mine.toml", epochs=3, learning_rate=1e-3, history_strides=(1, 2))
    assert read_recipe(str(path)) == expected


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"steps = 3\nstep = 4\n", "expected the name of a setting; got 'step'. Did you mean steps?"),
        (b"recipe = 'paper'\n", "expected the name of a setting; got 'recipe'. "),
        (b"steps = 0\n", "setting steps: Input should be greater than 0; got 0"),
        (b"steps = 3\nepochs = 1\n", "expected either steps or epochs; got both"),
        (b"box_loss_weights = [1.0]\n", "setting box_loss_weights: List should have at least 10 items"),
        (b"history = 'window'\n", "setting history: Input should be 'stream' or 'windows'; got 'window'"),
        (b"steps 3\n", "expected TOML"),
        (b"\xff\xfe", "expected TOML"),
        (b"a=" + b"[" * 100_000, "expected TOML"),
    ],
)
def test_a_file_with_a_mistake_is_refused_by_its_name(tmp_path, content, words):
    path = tmp_path / "mine.toml"
    path.write_bytes(content)
    with pytest.raises(InputError, match=re.escape(f"{path}: ")) as error:
        read_recipe(str(path))
    assert words in str(error.value)


def test_a_missing_file_a_folder_and_an_unknown_name_are_refused(tmp_path):
    with pytest.raises(InputError, match="expected a file; got no such file"):
        read_recipe(str(tmp_path / "none.toml"))
    (tmp_path / "folder.toml").mkdir()
    with pytest.raises(InputError, match="got a folder"):
        read_recipe(str(tmp_path / "folder.toml"))
    with pytest.raises(UsageError, match=r"--recipe: expected cpu, paper or a \.toml file; got 'papr'"):
        read_recipe("papr")


# --- Other values -------------------------------------------------------------------------------------------------


def test_options_and_assignments_replace_values_of_the_recipe():
    changed = override(read_recipe("paper"), {"seed": 7, "dropout": None}, ["past_frames=0", "tasks=detection"])
    assert (changed.seed, changed.past_frames, changed.tasks) == (7, 0, "detection")
    assert (changed.recipe, changed.dropout, changed.epochs) == ("paper", 0.1, 24)


def test_steps_replace_epochs_and_epochs_replace_steps():
    assert override(read_recipe("paper"), {"steps": 3}).epochs is None
    assert override(read_recipe("paper"), {"steps": 3}).steps == 3
    assert override(read_recipe("cpu"), {"epochs": 2}).epochs == 2
    assert override(read_recipe("paper"), {"steps": 3}, ["epochs=none"]).steps == 3
    with pytest.raises(UsageError, match="expected either --steps or --epochs; got both"):
        override(read_recipe("cpu"), {"steps": 3}, ["epochs=2"])


def test_the_learning_rate_of_the_backbone_keeps_its_ratio_unless_it_is_given():
    paper = read_recipe("paper")
    assert override(paper, {"learning_rate": 4e-4}).backbone_learning_rate == pytest.approx(4e-5)
    assert override(paper, {}, ["learning_rate=1e-3"]).backbone_learning_rate == pytest.approx(1e-4)
    assert override(paper, {"learning_rate": 4e-4, "backbone_learning_rate": 1e-5}).backbone_learning_rate == 1e-5
    assert override(paper, {"backbone_learning_rate": 1e-5}).learning_rate == 2e-4
    assert override(read_recipe("cpu"), {"learning_rate": 1.2e-3}).backbone_learning_rate == 1.2e-3


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("steps=3", 3),
        ("dropout=.5", 0.5),
        ("clip_norm=1.", 1.0),
        ("history=.", "."),
        ("dropout=5e-1", 0.5),
        ("pretraining=true", True),
        ("history=windows", "windows"),
        ('history="windows"', "windows"),
        ("history_strides=[1, 2]", [1, 2]),
        ("yaw_free_classes=['a=b']", ["a=b"]),
        ("past_frames=none", None),
        ("history=1\nsteps = 4", "1\nsteps = 4"),
        ("history=", ""),
    ],
)
def test_an_assignment_is_a_toml_value_or_text(text, value):
    assert parse_assignments([text]) == {text.partition("=")[0]: value}


@pytest.mark.parametrize(
    ("assignments", "words"),
    [
        (["steps"], "--set: expected NAME=VALUE; got 'steps'"),
        (["step=3"], "--set: expected the name of a setting; got 'step'. Did you mean steps?"),
        (["recipe=paper"], "--set: expected the name of a setting; got 'recipe'. "),
        (["zzz=1"], "--set: expected the name of a setting; got 'zzz'. The settings are steps, epochs, "),
        (["history_strides=1"], "--set history_strides: Input should be a list; got 1"),
        (["steps=3", "steps=4"], "--set steps: expected at most once; got it twice"),
        (["seed=3"], "--set seed: expected at most once; got --seed too"),
        (["dropout=1"], "--set dropout: Input should be less than 1; got 1"),
        (["dropout=nan"], "--set dropout: "),
        (["learning_rate=fast"], "--set learning_rate: Input should be a valid number"),
        (["history_strides=[]"], "--set history_strides: "),
        (["history_strides=[1, 0]"], "--set history_strides.1: Input should be greater than 0; got 0"),
        (["warmup_steps=true"], "--set warmup_steps: Input should be a valid integer; got True"),
        (["pretraining=1"], "--set pretraining: Input should be a valid boolean; got 1"),
        (["dropout=\x1b[2J"], "--set dropout: "),
    ],
)
def test_a_wrong_assignment_is_refused_by_the_name_of_its_setting(assignments, words):
    with pytest.raises(UsageError) as error:
        override(read_recipe("cpu"), {"seed": 1}, assignments)
    assert words in str(error.value)
    assert str(error.value).isprintable()


def test_a_wrong_option_is_refused_by_its_name():
    with pytest.raises(UsageError, match=r"^--batch-size: Input should be greater than 0; got 0\.$"):
        override(read_recipe("cpu"), {"batch_size": 0})
