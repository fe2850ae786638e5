"""The picture of a benchmark."""

import cv2
import numpy as np
import pytest
from matplotlib.colors import to_rgb

from duospacenet.jobs.benchmarking.bench_plot import COLOURS, check_picture_path, write_picture
from duospacenet.runtime.errors import OutputError
from tests.helpers.bench_reports import report


def count_pixels(picture, stage):
    bgr = np.round(255 * np.array(to_rgb(COLOURS[stage])[::-1]))
    return int((np.abs(picture - bgr) <= 1).all(axis=2).sum())


def test_the_areas_of_the_stages_have_the_proportions_of_their_times(tmp_path):
    """The backbone takes three times as long as the lifter."""
    write_picture(tmp_path / "speed.png", report())
    picture = cv2.imread(str(tmp_path / "speed.png")).astype(float)
    assert count_pixels(picture, "backbone") / count_pixels(picture, "lifter") == pytest.approx(3.0, rel=0.1)
    assert count_pixels(picture, "decoder") / count_pixels(picture, "lifter") == pytest.approx(0.75, rel=0.1)


def test_an_alternative_has_a_bar_in_proportion_to_its_ratio(tmp_path):
    write_picture(tmp_path / "speed.png", report({"eager": 6.0, "stateless": 3.0, "out/$name_with^signs$": 3.0}))
    picture = cv2.imread(str(tmp_path / "speed.png")).astype(float)
    assert count_pixels(picture, "model") / count_pixels(picture, "backbone") == pytest.approx(12 / 0.6, rel=0.1)


def test_paths_that_cannot_be_written_are_refused_before_the_measurement(tmp_path):
    (tmp_path / "old.png").touch()
    for name, words in (("old.png", "it exists already"), ("speed.jpg", "ends with .png"), ("none/a.png", "no folder")):
        with pytest.raises(OutputError, match=words):
            check_picture_path(tmp_path / name)
    check_picture_path(tmp_path / "new.png")
