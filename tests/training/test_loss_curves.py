"""Tests of the loss curves."""

import pytest

from duospacenet.training.loss_curves import draw_loss_curves, write_loss_curves


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
