"""The pages of `train`: the table of recipes equals the files, and the commands train what the page says."""

import shlex
from pathlib import Path
from types import SimpleNamespace

import pytest

from duospacenet import jobs
from duospacenet.cli.main import run_app
from tests.docs.test_documents import ROOT, commands
from tests.helpers.recipe_table import recipe_table

PAGE = ROOT / "docs" / "train.md"
TRAIN = [shlex.split(line)[1:] for line in commands(PAGE) if line.startswith("duospacenet train ")]
# Rows of the paper's tables by --out: tasks, epochs, frames of the window, decoder layers.
ROWS = {
    "table1-4-frames": ("detection", 24, 4, 4),
    "table1-1-frame": ("detection", 24, 1, 4),
    "table3-joint": ("both", 24, 1, 4),
    "table3-maps": ("maps", 24, 1, 4),
    "ablation": ("detection", 12, 1, 2),
}


def test_the_table_of_the_recipes_equals_the_files():
    """If this fails, replace the table on the page by the expected one."""
    assert recipe_table() in (ROOT / "docs" / "recipes.md").read_text()


@pytest.fixture
def call(tmp_path, monkeypatch, capfd):
    """Call the job of a command of the page instead of training; returns its arguments."""
    monkeypatch.chdir(tmp_path)
    for name in ("base", "small"):
        assert run_app(["config", "show", name]) == 0
        text = capfd.readouterr().out
        assert "\nnum_frames = 4\n" in text
        Path(f"{name}-1-frame.toml").write_text(text.replace("\nnum_frames = 4\n", "\nnum_frames = 1\n"))

    def call(arguments):
        calls = []

        def train_model(config, settings, out, **options):
            calls.append((config, settings, out, options))
            return SimpleNamespace(weights=out, steps=settings.steps, loss=1.0)

        monkeypatch.setattr(jobs, "train_model", train_model)
        assert run_app(arguments) == 0, capfd.readouterr().err
        return calls[0]

    return call


@pytest.mark.parametrize("arguments", TRAIN, ids=lambda arguments: arguments[arguments.index("--out") + 1])
def test_a_command_of_the_page_is_accepted_and_trains_what_the_page_says(call, arguments):
    config, settings, out, options = call(arguments)
    if out.name in ROWS:
        assert (settings.tasks, settings.epochs, config.num_frames, config.num_layers) == ROWS[out.name]
        assert (settings.recipe, settings.batch_size) == ("paper", 8)
        assert options["sources"] == ["nuscenes:/data/nuscenes/train"]


def test_each_row_of_the_tables_has_its_command():
    outs = [arguments[arguments.index("--out") + 1].rstrip("/") for arguments in TRAIN]
    assert set(ROWS) <= set(outs)
