"""The table of the ablations in the README: of the runs that ship, with the settings that the script has."""

from pathlib import Path

from benchmarks.ablation_scores import SCORES_NAME, TRAINING, digest_of, read_runs, spread
from tests.helpers.ablation_rows import TABLES

ROOT = Path(__file__).resolve().parents[2]
ROWS = {row for table in TABLES.values() for row in table}


def runs_that_ship():
    return read_runs(ROOT / "docs" / SCORES_NAME, digest_of(TRAINING))


def test_every_row_was_measured_from_two_seeds_with_the_settings_of_today():
    assert set(runs_that_ship()) == {(row, seed) for row in ROWS for seed in (0, 1)}


def test_the_readme_has_their_means_and_spreads():
    lines = (ROOT / "README.md").read_text().replace("*", "").splitlines()
    for row in ROWS:
        runs = [scores for (of, _), scores in runs_that_ship().items() if of == row]
        cells = "| " + " | ".join(spread([scores[name] for scores in runs]) for name in ("mAP", "NDS")) + " |"
        assert any(cells in line for line in lines), (row, cells)


def test_a_spread_is_the_mean_and_the_standard_deviation_of_those_that_are_known():
    assert spread([1.0, 3.0]) == "2.000 ± 1.414"
    assert spread([0.5, None]) == "0.500"
    assert spread([None]) == "-"
