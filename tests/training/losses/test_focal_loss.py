"""Tests of the focal loss, against numbers from the paper and cases worked by hand."""

import math

import pytest
import torch

from duospacenet.training.losses.focal_loss import focal_loss


def logit(score):
    return torch.tensor(math.log(score / (1 - score)), dtype=torch.float64)


@pytest.mark.parametrize(("score", "ratio"), [(0.9, 100), (0.968, 977)])
def test_a_well_classified_example_has_a_loss_as_small_as_in_the_paper(score, ratio):
    """Lin et al., 2017, section 3.2: with γ = 2, the loss is 100 times lower for p_t = 0.9, 1000 times for 0.968."""
    one = torch.tensor(1.0, dtype=torch.float64)
    focal, plain = (float(focal_loss(logit(score), one, alpha=1.0, gamma=gamma)) for gamma in (2.0, 0.0))
    assert plain == pytest.approx(-math.log(score))
    assert plain / focal == pytest.approx(ratio, rel=1e-3)


@pytest.mark.parametrize(
    ("score", "target", "expected"),
    [
        (0.9, 1, 0.25 * 0.01 * 0.1053605),  # α (1 - p)² · -ln p
        (0.9, 0, 0.75 * 0.81 * 2.3025851),  # (1 - α) p² · -ln (1 - p)
        (0.5, 1, 0.25 * 0.25 * 0.6931472),
        (0.5, 0, 0.75 * 0.25 * 0.6931472),
    ],
)
def test_alpha_weights_positive_against_negative_targets(score, target, expected):
    loss = focal_loss(logit(score), torch.tensor(float(target), dtype=torch.float64))
    assert float(loss) == pytest.approx(expected, rel=1e-6)


def test_the_focal_loss_of_an_extreme_logit_is_finite_and_has_a_gradient():
    logits = torch.tensor([-200.0, 200.0, -200.0, 200.0], requires_grad=True)
    loss = focal_loss(logits, torch.tensor([1.0, 0.0, 0.0, 1.0]))
    loss.sum().backward()
    assert loss.detach().numpy() == pytest.approx([50, 150, 0, 0])
    assert logits.grad.numpy() == pytest.approx([-0.25, 0.75, 0, 0], abs=1e-6)
