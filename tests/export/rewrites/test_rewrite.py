"""All rewrites together: equal results, fewer operations, and a given model that stays as it is."""

import copy

import pytest
import torch

from duospacenet.export.graphs import build_graphs, graphs_to_export
from duospacenet.export.rewrites import is_sum, rewrite
from duospacenet.model.complexity import count_flops
from tests.helpers.model_inputs import assert_close
from tests.helpers.rewritten_models import CONFIGS, inputs, model_of, outputs, outputs_of


@pytest.mark.parametrize("name", CONFIGS)
def test_the_outputs_of_the_model_stay(name):
    rewritten = outputs(rewrite(model_of(name)))
    assert rewritten.keys() == outputs_of(name).keys()
    for output, expected in outputs_of(name).items():
        # The roundings of all layers add up.
        assert_close(rewritten[output], expected, 5e-5)


@pytest.mark.parametrize("name", CONFIGS)
def test_each_graph_to_export_has_the_outputs_of_the_plain_graph_for_the_same_inputs(name):
    """The inputs of a graph are the outputs of the plain graphs before it."""
    config = CONFIGS[name]
    plain, exported = build_graphs(model_of(name)), graphs_to_export(model_of(name))
    assert [graph.name for graph in exported] == [graph.name for graph in plain]
    images, window = inputs(config)
    slots = []
    for t in range(config.num_frames):
        newest = min(t, len(images) - 1)  # the window has one slot more than the test has frames
        frame = {
            "images": images[newest],
            "image_T_ego": window.image_T_ego[newest],
            "camera_valid": window.camera_valid[newest],
        }
        for graph, other in zip(plain, exported, strict=True):
            if graph.name != "decoder":
                frame |= compare(graph, other, frame)
        slots.append(frame)
    full = type(window)(*(torch.cat((field, field[-1:])) for field in window))
    cached = {f"slot{t}.{name}": tensor for t, frame in enumerate(slots) for name, tensor in frame.items()}
    (decoder, other) = (next(graph for graph in graphs if graph.name == "decoder") for graphs in (plain, exported))
    assert compare(decoder, other, full._asdict() | cached)


def compare(graph, other, tensors):
    """Assert that the two graphs have near outputs for the tensors of their inputs; returns those of `graph`."""
    assert graph.inputs.keys() == other.inputs.keys()
    arguments = {name: tensors[name] for name in graph.inputs}
    expected, actual = graph(arguments), other(arguments)
    assert expected.keys() == actual.keys()
    for name, tensor in expected.items():
        if tensor.dtype == torch.bool:
            assert torch.equal(actual[name], tensor), name
        else:
            assert_close(actual[name], tensor, 1e-5)
    return expected


@pytest.mark.parametrize("name", ["tiny", "attention", "VoVNet"])
def test_the_given_model_stays_as_it_is(name):
    model = copy.deepcopy(model_of(name)).train().requires_grad_(True)
    before = {key: tensor.clone() for key, tensor in model.state_dict().items()}
    modules = [type(module) for module in model.modules()]
    outputs(rewrite(model))
    assert model.training
    assert all(parameter.requires_grad for parameter in model.parameters())
    assert [type(module) for module in model.modules()] == modules
    assert model.state_dict().keys() == before.keys()
    assert all(torch.equal(tensor, before[key]) for key, tensor in model.state_dict().items())


def test_a_rewritten_model_does_not_share_memory_with_the_given_one():
    model = copy.deepcopy(model_of("tiny"))
    rewritten = rewrite(model)
    expected = outputs(rewritten)
    for tensor in (*model.parameters(), *model.buffers()):
        tensor.zero_()
    for output, tensor in outputs(rewritten).items():
        assert torch.equal(tensor, expected[output])


@pytest.mark.parametrize("name", ["tiny", "pv", "bev-no-fde"])
def test_a_rewritten_model_needs_fewer_operations(name):
    images, window = inputs(CONFIGS[name])
    before, after = (
        count_flops(model, (images, *window), {})["total"] for model in (model_of(name), rewrite(model_of(name)))
    )
    assert after.by_paper < before.by_paper
    assert after.with_sampling - after.by_paper == before.with_sampling - before.by_paper


@pytest.mark.parametrize("name", CONFIGS)
def test_the_tensors_that_are_sums_of_products_are_named(name):
    """All other tensors are tensors of the model, or products of single numbers of them."""
    names = {key for key in rewrite(model_of(name)).state_dict() if is_sum(key)}
    spaces = {"bev": ("bev",), "bev-no-fde": ("bev",), "pv": ("pv",)}.get(name, ("bev", "pv"))
    assert names == {"queries.content"} | {
        f"decoder.layers.{layer}.cross_attention.{space}.attention.deformable.output.{kind}"
        for layer in range(CONFIGS[name].num_layers)
        for space in spaces
        for kind in ("weight", "bias")
    }
