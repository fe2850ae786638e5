"""Tests of the recorded ablation runs and of the documentation's table of their scores."""

from pathlib import Path

from benchmarks.ablation_scores import SCORES_NAME, TRAINING, hash_settings, mean_and_deviation, read_runs
from benchmarks.ablation_tables import ABLATION_ROWS

DOCS = Path(__file__).resolve().parents[2] / "docs"


def recorded_runs():
    return read_runs(DOCS / SCORES_NAME, hash_settings(TRAINING))


def test_every_row_was_run_with_two_seeds_and_the_settings_of_the_script():
    assert set(recorded_runs()) == {(row, seed) for row in ABLATION_ROWS for seed in (0, 1)}


def test_the_documented_table_has_the_mean_and_deviation_of_the_recorded_runs():
    lines = (DOCS / "results" / "ablations.md").read_text().replace("*", "").splitlines()
    for row in ABLATION_ROWS:
        runs = [scores for (name, _), scores in recorded_runs().items() if name == row]
        values = [mean_and_deviation([scores[name] for scores in runs]) for name in ("mAP", "NDS")]
        cells = f"| {' | '.join(values)} |"
        assert any(cells in line for line in lines), (row, cells)


def test_the_mean_and_the_standard_deviation_leave_out_missing_values():
    assert mean_and_deviation([1.0, 3.0]) == "2.000 ± 1.414"
    assert mean_and_deviation([0.5, None]) == "0.500"
    assert mean_and_deviation([None]) == "-"
