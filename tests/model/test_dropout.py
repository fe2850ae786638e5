"""Tests of the dropouts: where they act, and that they change nothing outside training or at a rate of 0."""

import pytest
import torch

from duospacenet.model import PRESETS
from duospacenet.model.attention import SelfAttention
from duospacenet.model.cross_attention import TemporalCrossAttention
from duospacenet.model.decoder import DecoderLayer, DuoSpaceDecoder
from duospacenet.model.dropout import Dropout
from duospacenet.model.window import TemporalQueries, Window

TINY = PRESETS["tiny"]


def randn(*shape):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(0))


@pytest.fixture
def layer():
    torch.manual_seed(0)
    return DecoderLayer(TINY).train()


def test_dropout_drops_at_its_rate_in_training_only():
    dropout, x = Dropout(), randn(100_000)
    assert dropout.train()(x) is x
    dropout.p = 0.25
    assert dropout.eval()(x) is x
    dropped = dropout.train()(x)
    kept = dropped != 0
    assert kept.float().mean().item() == pytest.approx(0.75, abs=0.01)
    torch.testing.assert_close(dropped[kept], x[kept] / 0.75)


def test_a_traced_graph_has_no_operation_for_a_dropout():
    dropout = Dropout()
    dropout.p = 0.5
    model = torch.nn.Sequential(torch.nn.ReLU(), dropout).eval()
    nodes = torch.export.export(model, (randn(3),)).graph.nodes
    assert [node.target.__name__ for node in nodes if node.op == "call_function"] == ["relu.default"]


def test_a_layer_has_the_dropouts_of_sparse4d(layer):
    """Attention weights, the output of each attention, and both layers of the feed-forward network."""
    names = {name for name, module in layer.named_modules() if isinstance(module, Dropout)}
    assert names == {
        "self_attention.dropout",
        "self_attention_dropout",
        "cross_attention.bev.dropout",
        "cross_attention.pv.dropout",
        "feedforward.1.1",
        "feedforward_dropout",
    }


def test_the_decoder_has_no_other_dropout():
    decoder = DuoSpaceDecoder(TINY)
    assert sum(isinstance(module, torch.nn.Dropout) for module in decoder.modules()) == 6 * TINY.num_layers


def test_without_attention_weights_the_self_attention_is_the_bias_of_its_output():
    attention = SelfAttention(32, 4).train()
    attention.dropout.p = 1.0
    output = attention(randn(5, 32))
    torch.testing.assert_close(output, attention.output.bias.expand(5, 32))


def test_without_the_output_of_the_self_attention_the_content_is_only_normalised(layer):
    content, embedding = randn(5, TINY.content_channels), randn(5, TINY.channels)
    layer.self_attention_dropout.p = 1.0
    torch.testing.assert_close(layer.attend_to_queries(content, embedding), layer.self_attention_norm(content))


class Attention(torch.nn.Module):
    """Attention to one frame that returns its queries."""

    def forward(self, query, poses, frames, window):
        return query


def one_frame(num_queries):
    queries = TemporalQueries(torch.zeros(1, num_queries, 10), randn(1, num_queries, TINY.channels))
    one = torch.ones(1, dtype=torch.bool)
    return queries, Window(torch.zeros(1, 6, 3, 4), torch.eye(4)[None], torch.zeros(1), one, one.expand(1, 6))


def test_without_the_output_of_the_cross_attention_the_content_is_only_normalised():
    attention = TemporalCrossAttention(Attention(), TINY.channels).train()
    queries, window = one_frame(5)
    content = randn(5, TINY.channels)
    assert not attention(content, queries, [None], window).allclose(attention.norm(content))
    attention.dropout.p = 1.0
    torch.testing.assert_close(attention(content, queries, [None], window), attention.norm(content))


@pytest.mark.parametrize("name", ["feedforward.1.1", "feedforward_dropout"])
def test_without_the_hidden_layer_the_feedforward_network_is_its_bias_and_without_its_output_it_is_zero(layer, name):
    layer.cross_attention = torch.nn.Module()
    layer.cross_attention.forward = lambda content, *_: content
    layer.get_submodule(name).p = 1.0
    queries, window = one_frame(5)
    content = randn(5, TINY.content_channels)
    before = layer.attend_to_queries(content, queries.embeddings[0])
    added = layer.feedforward[2].bias if name == "feedforward.1.1" else 0.0
    torch.testing.assert_close(layer(content, queries, None, window)[0], layer.feedforward_norm(before + added))
