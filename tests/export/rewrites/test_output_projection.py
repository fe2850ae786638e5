"""The output projection of attention is folded into the first layer of the temporal recurrence."""

import pytest
import torch
from torch import nn

from duospacenet.export.rewrites.output_projection import SplitRecurrence, fold_output_projections
from duospacenet.model.cross_attention import TemporalCrossAttention
from duospacenet.model.presets import ABLATIONS
from tests.helpers import references
from tests.helpers.model_inputs import assert_close, normal
from tests.helpers.rewritten_models import (
    CONFIGS,
    NUM_FRAMES,
    called_operators,
    model_of,
    outputs,
    outputs_of,
    rewritten_by,
)


def cross_attentions(model):
    return [module for module in model.decoder.modules() if isinstance(module, TemporalCrossAttention)]


@pytest.mark.parametrize("name", ["tiny", *ABLATIONS, "one layer", "three layers"])
def test_the_outputs_of_the_model_stay(name):
    rewritten = outputs(rewritten_by(fold_output_projections, name))
    for output, expected in outputs_of(name).items():
        assert_close(rewritten[output], expected, 1e-5)


@pytest.mark.parametrize("valid", [(1, 1, 1, 1), (1, 1, 0, 1), (1, 0, 0, 0), (1, 1, 1, 0), (0, 0, 0, 0)])
def test_projection_and_recurrence_equal_the_loop(valid):
    """For every pattern of masked frames; a masked frame holds NaN."""
    plain = cross_attentions(model_of("tiny"))[0]
    sums = normal(4, 10, 32, seed=1)
    projection = plain.attention.deformable.output
    attended = references.linear(references.weights_of(projection), sums.double().numpy())
    expected = references.recurrence(references.weights_of(plain.recurrence), list(attended), valid)

    rewritten = cross_attentions(rewritten_by(fold_output_projections, "tiny"))[0]
    frame_valid = torch.tensor(valid, dtype=torch.bool)
    sums[~frame_valid] = torch.nan
    state = rewritten.recurrence(rewritten.attention.deformable.output(sums), frame_valid)
    if any(valid):
        assert_close(state, expected, 1e-5)
    else:
        assert torch.equal(state, torch.zeros(10, 32))


@pytest.mark.parametrize("name", ["tiny", "three layers", "unshared", "shared-content", "bev", "pv"])
def test_every_recurrence_has_one_linear_layer_fewer_and_none_that_reads_state_and_output(name):
    """The oldest frame has no state yet, so its first layer needs no product."""
    rewritten = rewritten_by(fold_output_projections, name)
    attentions = cross_attentions(rewritten)
    assert all(isinstance(each.recurrence, SplitRecurrence) for each in attentions)
    for attention in attentions:
        layers = [module for module in attention.recurrence.modules() if isinstance(module, nn.Linear)]
        assert [(layer.in_features, layer.out_features) for layer in layers] == [(32, 32)] * 3
    before, after = called_operators(model_of(name)), called_operators(rewritten)
    assert len(attentions) == (1 if name in ("bev", "pv") else 2) * CONFIGS[name].num_layers
    assert before["aten.addmm.default"] - after["aten.addmm.default"] == len(attentions)
    # Without the concatenation of state and output.
    assert before["aten.cat.default"] - after["aten.cat.default"] == NUM_FRAMES * len(attentions)


def test_attention_over_past_bev_features_keeps_its_projection():
    """Its output is not the input of a recurrence."""
    before = model_of("attention").decoder.bev_fusion.state_dict()
    after = rewritten_by(fold_output_projections, "attention").decoder.bev_fusion.state_dict()
    assert before.keys() == after.keys()
    assert all(torch.equal(tensor, before[key]) for key, tensor in after.items())
