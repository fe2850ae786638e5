"""`inspect --complexity`: of a preset and of a bundle."""

import json

import pytest

from duospacenet.cli.main import run_app
from duospacenet.model import PRESETS
from duospacenet.model.complexity import measure


def test_a_presets_complexity_is_a_table_in_millions_and_billions(capfd):
    assert run_app(["inspect", "--preset", "base", "--complexity"]) == 0
    printed = capfd.readouterr()
    rows = {cells[1].strip(): cells[2:5] for line in printed.out.splitlines() if len(cells := line.split("│")) == 6}
    assert list(rows) == ["encoder", "lifter", "FDE", "decoder", "segmentation", "total"]
    parameters, flops, with_sampling = map(float, rows["total"])
    assert parameters == pytest.approx(64.8, rel=0.03)
    assert flops == pytest.approx(1771.7, rel=0.03)
    assert with_sampling > flops
    assert printed.err == ""


def test_json_has_the_numbers_themselves(capfd):
    assert run_app(["inspect", "--preset", "tiny", "--complexity", "--frames", "2", "--json"]) == 0
    shown = json.loads(capfd.readouterr().out)
    assert (shown["preset"], shown["frames"]) == ("tiny", 2)
    assert shown["parts"] == {name: part._asdict() for name, part in measure(PRESETS["tiny"], 2).items()}


def test_a_bundles_complexity_is_that_of_its_configuration(tiny_bundle, capfd):
    assert run_app(["inspect", str(tiny_bundle), "--complexity", "--json"]) == 0
    assert run_app(["inspect", "--preset", "tiny", "--complexity", "--json"]) == 0
    of_bundle, of_preset = map(json.loads, capfd.readouterr().out.splitlines())
    assert of_bundle == of_preset


USAGE = {
    "neither": ([], "expected either BUNDLE or --preset"),
    "both": (["bundle", "--preset", "tiny", "--complexity"], "expected either BUNDLE or --preset"),
    "a preset alone": (["--preset", "tiny"], "--preset: expected with --complexity"),
    "no such preset": (["--preset", "huge", "--complexity"], "--preset: expected one of"),
    "no frames": (["--preset", "tiny", "--complexity", "--frames", "0"], "--frames"),
}


@pytest.mark.parametrize("call", USAGE)
def test_a_call_that_names_no_one_model_is_a_usage_error(capfd, call):
    arguments, words = USAGE[call]
    assert run_app(["inspect", *arguments]) == 2
    printed = capfd.readouterr()
    assert words in printed.err
    assert printed.out == ""
