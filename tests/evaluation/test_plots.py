"""The plots are written completely or not at all."""

import cv2
import numpy as np
import pytest

from duospacenet.evaluation import EvaluationReport, evaluate, plots
from duospacenet.runtime.errors import OutputError
from tests.helpers.evaluation_samples import random_sample

LINE_COLORS_BGR = [(180, 119, 31), (14, 127, 255), (44, 160, 44), (40, 39, 214)]  # matplotlib's first four


@pytest.fixture(scope="module")
def report() -> EvaluationReport:
    rng = np.random.default_rng(1)
    return evaluate([random_sample(rng) for _ in range(8)])


def test_both_plots_are_written_with_lines_in_all_colours(report, tmp_path):
    plots.write_plots(tmp_path / "plots", report)
    assert sorted(path.name for path in (tmp_path / "plots").iterdir()) == ["errors.png", "precision.png"]
    for path in (tmp_path / "plots").iterdir():
        picture = cv2.imread(str(path))
        assert picture.shape == (640, 1600, 3)
        for color in LINE_COLORS_BGR:
            assert (picture == color).all(axis=2).sum() > 300, path


def test_an_existing_folder_is_refused(report, tmp_path):
    with pytest.raises(OutputError, match="exists already"):
        plots.write_plots(tmp_path, report)


@pytest.mark.parametrize("failure", [KeyboardInterrupt(), OSError(28, "No space left on device")])
def test_a_failure_while_writing_leaves_no_files(report, tmp_path, monkeypatch, failure):
    def fail(*_):
        raise failure

    monkeypatch.setattr(plots, "_draw_errors", fail)
    with pytest.raises((KeyboardInterrupt, OutputError)):
        plots.write_plots(tmp_path / "plots", report)
    assert list(tmp_path.iterdir()) == []
