"""The plot of scores over lost cameras."""

import cv2
import numpy as np
import pytest

from duospacenet.evaluation import evaluate, plots
from duospacenet.evaluation.lost_camera_plot import write_lost_camera_plot
from tests.helpers.evaluation_samples import random_sample

NDS_BGR, MAP_BGR = (180, 119, 31), (14, 127, 255)  # matplotlib's first two colours


def columns_and_rows(picture, colour):
    rows, columns = np.nonzero((picture == colour).all(axis=2))
    return columns, rows


def test_a_falling_score_falls_from_left_to_right_and_the_higher_one_is_above(tmp_path):
    write_lost_camera_plot(tmp_path / "plot.png", {"NDS": [0.5, 0.4, 0.1], "mAP": [0.4, 0.2, 0.05]})
    picture = cv2.imread(str(tmp_path / "plot.png"))
    assert picture.shape == (450, 700, 3)
    columns, rows = columns_and_rows(picture[60:, :600], NDS_BGR)  # without the legend
    left, right = columns < np.percentile(columns, 20), columns > np.percentile(columns, 80)
    assert rows[left].mean() + 50 < rows[right].mean()
    _, lower = columns_and_rows(picture[60:, :600], MAP_BGR)
    assert rows.mean() < lower.mean()


@pytest.mark.parametrize("values", [[0.0, 0.0], [0.3], []])
def test_scores_of_zero_and_single_scores_have_a_plot(tmp_path, values):
    write_lost_camera_plot(tmp_path / "plot.png", {"NDS": values})
    assert cv2.imread(str(tmp_path / "plot.png")) is not None


def test_the_plot_is_beside_the_others_only_with_such_scores(tmp_path):
    report = evaluate([random_sample(np.random.default_rng(1))])
    plots.write_plots(tmp_path / "with", report, {"NDS": [0.5, 0.4]})
    plots.write_plots(tmp_path / "without", report)
    assert {path.name for path in (tmp_path / "with").iterdir()} - {
        path.name for path in (tmp_path / "without").iterdir()
    } == {"lost_cameras.png"}
