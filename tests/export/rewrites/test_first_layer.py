"""The self-attention of the first decoder layer is replaced by its result, which is a constant."""

import numpy as np
import pytest
import torch

from duospacenet.export.rewrites.first_layer import fold_first_self_attention
from duospacenet.model.attention import SelfAttention
from duospacenet.model.presets import ABLATIONS
from tests.helpers import references
from tests.helpers.model_inputs import assert_close
from tests.helpers.rewritten_models import CONFIGS, called_operators, model_of, outputs, outputs_of, rewritten_by


@pytest.mark.parametrize("name", ["tiny", *ABLATIONS, "one layer", "three layers"])
def test_the_outputs_of_the_model_stay(name):
    rewritten = outputs(rewritten_by(fold_first_self_attention, name))
    for output, expected in outputs_of(name).items():
        assert_close(rewritten[output], expected, 1e-5)


@pytest.mark.parametrize("name", ["tiny", "bev", "unshared"])
def test_the_new_content_equals_the_loop(name):
    """Eqs. 1 to 4 with the initial queries."""
    model = model_of(name)
    layer = references.part(references.weights_of(model.decoder), "layers.0")
    content, pose = (tensor.double().numpy() for tensor in model.queries())
    unit = np.array([51.2, 51.2, 5, 1, 1, 1, 1, 1, 10, 10])
    embedding = references.pose_encoder(references.weights_of(model.decoder.pose_encoder), pose, unit)
    z = content + np.concatenate([embedding] * (2 if name == "tiny" else 1), axis=-1)
    mixed = references.self_attention(references.part(layer, "self_attention"), z, 4)
    expected = references.layer_norm(references.part(layer, "self_attention_norm"), content + mixed)
    assert_close(rewritten_by(fold_first_self_attention, name).queries.content, expected, 1e-6)


@pytest.mark.parametrize("name", ["tiny", "one layer", "three layers", "VoVNet"])
def test_only_the_first_layer_loses_its_self_attention(name):
    rewritten = rewritten_by(fold_first_self_attention, name)
    kept = [isinstance(layer.self_attention, SelfAttention) for layer in rewritten.decoder.layers]
    assert kept == [False] + [True] * (CONFIGS[name].num_layers - 1)
    before, after = called_operators(model_of(name)), called_operators(rewritten)
    assert before["aten._softmax.default"] - after["aten._softmax.default"] == 1
    assert before["aten.native_layer_norm.default"] - after["aten.native_layer_norm.default"] == 1


def test_the_poses_of_the_queries_stay():
    rewritten = rewritten_by(fold_first_self_attention, "tiny")
    assert torch.equal(rewritten.queries.pose, model_of("tiny").queries.pose)
