"""`config show`, and a configuration of one's own from `--config` to the evaluation."""

import json
import tomllib
from dataclasses import replace
from pathlib import Path

import pytest

from duospacenet.cli.main import run_app
from duospacenet.model import PRESETS, DuoSpaceNet, DuoSpaceNetConfig, randomise
from duospacenet.weights import save_checkpoint

MINE = replace(PRESETS["tiny"], preset="mine", num_queries=24)


@pytest.mark.parametrize("preset", ["tiny", "nano", "large", "small-pv"])
def test_a_preset_is_shown_as_toml_or_json(capsys, preset):
    for options, parse in (
        ([], tomllib.loads),
        (["--format", "toml"], tomllib.loads),
        (["--format", "json"], json.loads),
    ):
        assert run_app(["config", "show", preset, *options]) == 0
        printed = capsys.readouterr()
        assert DuoSpaceNetConfig.from_dict(parse(printed.out)) == PRESETS[preset]
        assert printed.err == ""


def test_an_unknown_preset_or_format_is_refused(capsys):
    assert run_app(["config", "show", "smal"]) == 2
    assert "expected one of tiny, nano, small, base, large" in capsys.readouterr().err
    assert run_app(["config", "show", "small", "--format", "yaml"]) == 2
    assert "yaml" in capsys.readouterr().err


@pytest.fixture(scope="module")
def config_file(tmp_path_factory) -> Path:
    """The configuration that `config show tiny` prints, edited as a user would."""
    path = tmp_path_factory.mktemp("config") / "mine.json"
    path.write_text(json.dumps(MINE.to_dict()))
    return path


@pytest.fixture(scope="module")
def weights(tmp_path_factory) -> Path:
    """Weights with their configuration in the metadata, as `train` writes them."""
    path = tmp_path_factory.mktemp("weights") / "mine.safetensors"
    save_checkpoint(path, randomise(DuoSpaceNet(MINE), seed=4), {"config": json.dumps(MINE.to_dict())})
    return path


@pytest.mark.parametrize(
    "options", [["--preset", "tiny"], ["--weights", "{weights}", "--preset", "nano"], ["--random-weights"]]
)
def test_a_preset_and_a_configuration_file_exclude_each_other_and_one_is_needed(
    config_file, weights, tmp_path, capsys, options
):
    options = [option.format(weights=weights) for option in options]
    both = ["--config", str(config_file)] if "--preset" in options else []
    assert run_app(["export", *options, *both, "--out", str(tmp_path / "bundle")]) == 2
    assert "got both" if both else "got neither" in capsys.readouterr().err


COMMANDS_WITH_CONFIG = [
    ["export", "--random-weights", "--out", "{out}"],
    ["inspect", "--complexity"],
    ["train", "--out", "{out}"],
]


@pytest.mark.parametrize("arguments", COMMANDS_WITH_CONFIG)
def test_a_mistake_in_a_configuration_file_ends_with_3_and_names_file_and_field(tmp_path, capsys, arguments):
    path = tmp_path / "mine.json"
    path.write_text(json.dumps(MINE.to_dict() | {"num_querys": 24}))
    arguments = [argument.format(out=tmp_path / "out") for argument in arguments]
    assert run_app([*arguments, "--config", str(path)]) == 3
    assert f"error: {path}: field num_querys is unknown; expected only preset, image" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_the_complexity_of_an_own_configuration_is_counted(config_file, capsys):
    assert run_app(["inspect", "--config", str(config_file), "--complexity", "--json"]) == 0
    mine = json.loads(capsys.readouterr().out)
    assert run_app(["inspect", "--preset", "tiny", "--complexity", "--json"]) == 0
    tiny = json.loads(capsys.readouterr().out)
    assert mine["preset"] == "mine"
    fewer = tiny["parts"]["total"]["parameters"] - mine["parts"]["total"]["parameters"]
    assert fewer == 8 * (10 + 2 * MINE.channels)  # a pose and two content embeddings for each of 8 queries


@pytest.fixture(scope="module")
def bundle(weights, tmp_path_factory) -> Path:
    """Exported without --preset: the configuration comes from the weights."""
    out = tmp_path_factory.mktemp("mine") / "bundle"
    assert run_app(["export", "--weights", str(weights), "--out", str(out)]) == 0
    return out


@pytest.mark.slow
def test_an_own_configuration_is_exported_inspected_run_and_evaluated(bundle, weights, tmp_path, capsys):
    assert run_app(["inspect", str(bundle), "--json"]) == 0
    manifest = json.loads(capsys.readouterr().out)
    assert (manifest["preset"], manifest["config"]) == ("mine", json.loads(json.dumps(MINE.to_dict())))
    assert manifest["parity"]["passed"] is True
    assert run_app(["parity", str(bundle), "--weights", str(weights), "--no-retrace", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["passed"] is True
    assert run_app(["run", str(bundle), "synthetic:3:2", "--out", str(tmp_path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["boxes"] == 2 * 240  # 24 queries x 10 classes
    scores = []
    for options in ([], ["--eager", "--weights", str(weights)]):
        assert run_app(["eval", str(bundle), "synthetic:3:2", *options, "--json"]) == 0
        scores.append(json.loads(capsys.readouterr().out))
    assert scores[0]["NDS"] == pytest.approx(scores[1]["NDS"], abs=1e-4)


@pytest.mark.slow
def test_the_configuration_file_and_the_metadata_give_the_same_export(bundle, config_file, weights, tmp_path):
    out = tmp_path / "bundle"
    assert run_app(["export", "--config", str(config_file), "--weights", str(weights), "--out", str(out)]) == 0
    for path in bundle.glob("*.onnx"):
        assert (out / path.name).read_bytes() == path.read_bytes()
