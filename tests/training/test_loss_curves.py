"""Tests of the loss curves."""

import pytest

from duospacenet.training.loss_curves import write_loss_curves


@pytest.mark.parametrize("num_steps", [0, 1, 3, 300])
def test_loss_curves_can_be_written_for_any_number_of_steps(tmp_path, num_steps):
    log = [{"step": step, "gradient_norm": 1.0, "class_0": 2.0 / (step + 1), "total": 3.0} for step in range(num_steps)]
    write_loss_curves(log, tmp_path / "losses.png")
    assert (tmp_path / "losses.png").read_bytes().startswith(b"\x89PNG")
