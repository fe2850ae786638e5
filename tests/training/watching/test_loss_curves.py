"""Tests of the loss curves."""

import pytest

from duospacenet.training.watching.loss_curves import draw_loss_curves, write_loss_curves
from duospacenet.training.watching.validation_scores import ValidationScores


@pytest.mark.parametrize("num_steps", [0, 1, 3, 300])
def test_loss_curves_can_be_written_for_any_number_of_steps(tmp_path, num_steps):
    log = [{"step": step, "gradient_norm": 1.0, "class_0": 2.0 / (step + 1), "total": 3.0} for step in range(num_steps)]
    write_loss_curves(log, [], tmp_path / "losses.png")
    assert (tmp_path / "losses.png").read_bytes().startswith(b"\x89PNG")


def test_the_curves_of_a_model_with_six_decoder_layers_can_be_told_apart():
    names = [f"{kind}_{layer}" for kind in ("class", "box", "denoised") for layer in range(6)]
    names += [f"other_{index}" for index in range(9)]
    _, part_axes = draw_loss_curves([{"step": 0, **dict.fromkeys(names, 1.0), "total": 27.0}]).axes
    assert len({(line.get_color(), line.get_linestyle()) for line in part_axes.get_lines()}) == len(names) == 27


def test_scores_of_validations_have_curves_of_their_own(tmp_path):
    """Only the second validation has boxes. mAVE is left out, because it is not between 0 and 1."""
    log = [
        {"step": step, "epoch": 0.5, "learning_rate": 1e-3, "step_s": 1.0, "box_0": 1.0, "total": 3.0}
        for step in range(8)
    ]
    maps = {"drivable_area": 0.5, "lane_boundary": None}
    validations = [
        ValidationScores(4, "drives", None, None, None, maps),
        ValidationScores(8, "drives", 0.25, 0.75, 1.5, maps),
    ]
    total_axes, part_axes, score_axes = draw_loss_curves(log, validations).axes
    curves = {line.get_label(): list(zip(*line.get_data(), strict=True)) for line in score_axes.get_lines()}
    assert curves == {"IoU drivable area": [(4, 0.5), (8, 0.5)], "mAP": [(8, 0.25)], "NDS": [(8, 0.75)]}
    assert (len(total_axes.get_lines()), len(part_axes.get_lines())) == (1, 1)  # rates and times are not losses
    write_loss_curves([], validations, tmp_path / "losses.png")
    assert (tmp_path / "losses.png").read_bytes().startswith(b"\x89PNG")
