"""Weights are compared by value: every tensor of the model is found, and a single changed number is named."""

from dataclasses import replace
from unittest import mock

import numpy as np
import onnx
import pytest
import torch
from onnx import numpy_helper

from duospacenet.export.graphs import build_graphs, graphs_to_export
from duospacenet.export.operator_forms import OperatorForms
from duospacenet.export.parity import weight_match
from duospacenet.export.parity.used_tensors import used_tensors
from duospacenet.export.parity.weight_match import match_weights
from duospacenet.export.tracing import trace
from duospacenet.model import PRESETS, DuoSpaceNet, randomise
from duospacenet.model.config import ResNetConfig
from tests.faults.bench import nodes_of, set_attribute
from tests.helpers.exports import share_conversions

# With deformable convolutions as formulas, their BatchNorms are not folded, and the graph holds positions of pixels.
DEFORMABLE = replace(
    PRESETS["tiny-pv"],
    backbone=ResNetConfig("bottleneck", (1, 1, 1, 1), width=8, deformable_stages=(3, 4)),
    num_layers=1,
    num_frames=1,
    num_cameras=1,
)


@pytest.fixture(autouse=True, scope="module")
def tensors_found_once():
    """What the graphs of a model use is found once per model, because it takes a second."""
    found = {}

    def cached(graph):
        key = graph.name, id(graph.model)
        if key not in found:
            found[key] = graph.model, used_tensors(graph)
        return found[key][1]

    with mock.patch.object(weight_match, "used_tensors", cached):
        yield


@pytest.fixture
def files(tiny_bundle):
    """The graph files of `tiny_bundle` by name. A test may change them."""
    return {path.stem: onnx.load(path) for path in tiny_bundle.glob("*.onnx")}


@pytest.fixture(scope="module")
def graphs(tiny_model):
    return graphs_to_export(tiny_model)


def match(files, graphs):
    return match_weights({name: file.SerializeToString() for name, file in files.items()}, graphs)


def weights_of(files):
    """The constants with more than 16 different floating-point numbers, not all whole, as (graph, initializer).

    The exporter's own constants have few different numbers, or whole ones such as positions.
    """
    return [
        (name, tensor)
        for name, file in sorted(files.items())
        for tensor in file.graph.initializer
        if tensor.data_type in (onnx.TensorProto.FLOAT, onnx.TensorProto.DOUBLE)
        and np.unique(numpy_helper.to_array(tensor)).size > 16
        and (numpy_helper.to_array(tensor) % 1 != 0).any()
    ]


def change(tensor, edit):
    """Apply `edit` to a copy of an initializer's values, and store its result."""
    values = numpy_helper.to_array(tensor).copy()
    tensor.CopyFrom(numpy_helper.from_array(edit(values).astype(values.dtype), tensor.name))


def scale_one(values, index, factor):
    values.ravel()[index] *= factor
    return values


def test_every_tensor_of_a_clean_export_is_found(tiny_bundle, graphs):
    found = match_weights({path.stem: path for path in tiny_bundle.glob("*.onnx")}, graphs)
    assert found.failures == []
    assert found.not_found == ()
    # All but the class heads of the first layer, which no output depends on, and the counters of the BatchNorms.
    model = graphs[0].model
    unused = {name for name, _ in model.named_parameters() if name.startswith("decoder.layers.0.heads.classes.")}
    tensors = {**dict(model.named_parameters()), **dict(model.named_buffers())}
    used = [t for name, t in tensors.items() if name not in unused and not name.endswith(".num_batches_tracked")]
    assert (found.parameters, found.values) == (len(used), sum(t.numel() for t in used))
    assert (found.matched, found.matched_values) == (found.parameters, found.values)


@pytest.fixture(scope="module")
def formulas(tmp_path_factory):
    """The graphs of `DEFORMABLE` and their files, with formulas in place of deformable operators."""
    graphs, folder = graphs_to_export(randomise(DuoSpaceNet(DEFORMABLE)).eval()), tmp_path_factory.mktemp("formulas")
    paths = {graph.name: folder / f"{graph.name}.onnx" for graph in graphs}
    with share_conversions():
        for graph in graphs:
            trace(graph, paths[graph.name], OperatorForms("grid-sample", "grid-sample"))
    return graphs, paths


def test_weights_that_are_not_folded_are_found(formulas):
    graphs, paths = formulas
    found = match_weights(paths, graphs)
    assert found.failures == []
    assert found.matched_values == found.values > 0


@pytest.mark.parametrize("factor", [1.01, 1.1, 1 + 1e-5, -1.0])
def test_64_changed_weights_are_all_found_and_named(files, graphs, factor):
    random = np.random.default_rng(int(abs(factor) * 100))
    weights = weights_of(files)
    changed = {}
    for place in random.choice(len(weights), 64, replace=False):
        graph, tensor = weights[place]
        # Below its rounding error a folded bias is not compared: its terms may cancel. So the largest number changes.
        index = int(np.abs(numpy_helper.to_array(tensor)).argmax())
        change(tensor, lambda values, index=index: scale_one(values, index, factor))
        changed[graph, tensor.name] = np.unravel_index(index, tuple(tensor.dims))
    found = match(files, graphs)
    assert {(each.graph, each.constant): each.index for each in found.differing} == changed
    assert {each.numbers for each in found.differing} == {1}
    for each in found.differing:
        assert each.value == pytest.approx(each.expected * factor, rel=2e-6)
    assert found.unexplained == ()


def test_a_random_number_of_every_weight_may_change_by_one_percent(files, graphs):
    random = np.random.default_rng(5)
    weights = [(graph, tensor) for graph, tensor in weights_of(files) if not tensor.name.endswith("_bias")]
    for _, tensor in weights:
        change(tensor, lambda values: scale_one(values, random.integers(values.size), 1.01))
    found = match(files, graphs)
    assert {(each.graph, each.constant) for each in found.differing} == {(name, t.name) for name, t in weights}


def test_the_last_bit_of_a_weight_that_is_not_folded_is_found(files, graphs):
    tensor = next(t for t in files["decoder"].graph.initializer if t.name.endswith("layers.1.feedforward.2.weight"))
    change(tensor, lambda values: scale_one(values, 7, 1 + 1.2e-7))
    (difference,) = match(files, graphs).differing
    assert (difference.tensor, difference.numbers) == ("decoder.layers.1.feedforward.2.weight", 1)


@pytest.mark.parametrize("named", [True, False], ids=["with the exporter's names", "with other names"])
@pytest.mark.parametrize(
    "edit",
    [
        lambda values: values[[1, 0, *range(2, len(values))]],
        lambda values: np.random.default_rng(0).permutation(values.ravel()).reshape(values.shape),
        np.zeros_like,
        np.ones_like,
        lambda values: np.full_like(values, np.nan),
        lambda values: values * np.float32(1.01),
        lambda values: values.astype(np.float16),
        lambda values: np.random.default_rng(0).normal(size=values.shape),
    ],
    ids=["two rows swapped", "permuted", "zeros", "ones", "NaN", "all changed", "half precision", "random"],
)
def test_a_changed_tensor_is_found_and_named(files, graphs, edit, named):
    graph, tensor = next((g, t) for g, t in weights_of(files) if t.name.endswith("conv2d.1.0.weight"))
    change(tensor, edit)
    if not named:
        rename(files[graph], tensor.name, "w")
    found = match(files, graphs)
    (difference,) = found.differing
    assert difference.graph == "lifter"
    if named:
        assert difference.tensor == "divergence_enhancement.conv2d.1.0.weight"


def rename(model, old, new):
    for node in model.graph.node:
        node.input[:] = [new if name == old else name for name in node.input]
    next(tensor for tensor in model.graph.initializer if tensor.name == old).name = new


def test_names_do_not_matter(files, graphs):
    """Initializers with exchanged names are still found by value, and nothing differs."""
    for model in files.values():
        for place, name in enumerate([tensor.name for tensor in model.graph.initializer]):
            rename(model, name, f"w{place}")
    found = match(files, graphs)
    assert found.failures == []
    assert found.matched_values == found.values


def test_a_constant_that_holds_no_weight_is_reported(files, graphs):
    extra = np.random.default_rng(0).normal(size=77).astype(np.float32)
    files["segmenter"].graph.initializer.append(numpy_helper.from_array(extra, "extra"))
    found = match(files, graphs)
    assert found.unexplained == ("segmenter.extra",)
    assert found.failures == ["segmenter.extra: expected a tensor of the model; got other numbers"]


def test_a_weight_in_a_constant_node_is_found(files, graphs):
    model = files["decoder"]
    place, tensor = next(
        (i, t) for i, t in enumerate(model.graph.initializer) if t.name.endswith("feedforward.0.weight")
    )
    values, name = numpy_helper.to_array(tensor), tensor.name
    del model.graph.initializer[place]
    model.graph.node.insert(0, onnx.helper.make_node("Constant", [], [name], value=numpy_helper.from_array(values)))
    found = match(files, graphs)
    assert found.matched_values == found.values
    change(model.graph.node[0].attribute[0].t, lambda values: scale_one(values, 0, 1.01))
    assert [each.constant for each in match(files, graphs).differing] == [name]


def test_another_epsilon_of_the_folded_batch_norms_is_found(files, graphs, tiny_model):
    """The folded values of 1e-5 and of 1.001e-5 differ by 5e-9, which float32 cannot hold. Those of 2e-5 differ."""
    bn = tiny_model.image_encoder.backbone.bn1
    scale = np.sqrt((bn.running_var.numpy() + 1e-5) / (bn.running_var.numpy() + 2e-5))
    tensor = next(t for t in files["backbone"].graph.initializer if t.name.endswith("backbone.conv1.weight"))
    change(tensor, lambda values: values * scale[:, None, None, None])
    (difference,) = match(files, graphs).differing
    assert difference.tensor == "image_encoder.backbone.conv1.weight"


def test_the_tensors_of_another_checkpoint_differ(files, tiny_model):
    other = randomise(DuoSpaceNet(tiny_model.config), seed=1).eval()
    found = match(files, graphs_to_export(other))
    assert len(found.differing) > 100
    assert len(found.failures) == 11
    # The means, units and positions are those of every model of this configuration.
    assert found.matched_values < 0.02 * found.values


# --- Attributes ---------------------------------------------------------------------------------------------------


def attributes_after(files, graphs, graph, operator, attribute, value, place=0):
    set_attribute(nodes_of(files[graph], operator)[place], attribute, value)
    return [(each.graph, each.operator, each.attribute) for each in match(files, graphs).attributes]


@pytest.mark.parametrize("place", [0, 4, 13])
def test_another_epsilon_of_a_layer_norm_is_found(files, graphs, place):
    changed = attributes_after(files, graphs, "decoder", "LayerNormalization", "epsilon", 1e-4, place)
    assert changed == [("decoder", "LayerNormalization", "epsilon")]


@pytest.mark.parametrize(
    ("graph", "operator", "attribute", "value"),
    [
        ("backbone", "Conv", "strides", [1, 1]),
        ("backbone", "Conv", "pads", [3, 3, 2, 4]),
        ("lifter", "Conv", "dilations", [2, 2]),
        ("decoder", "GridSample", "align_corners", 1),
        ("lifter", "GridSample", "padding_mode", "border"),
        ("decoder", "GridSample", "mode", "nearest"),
        ("decoder", "Softmax", "axis", 1),
        ("decoder", "Gemm", "alpha", 1.001),
    ],
)
def test_another_attribute_is_found(files, graphs, graph, operator, attribute, value):
    assert attributes_after(files, graphs, graph, operator, attribute, value) == [(graph, operator, attribute)]


def test_a_missing_attribute_has_its_default(files, graphs):
    """ONNX's default epsilon is 1e-5, which is also PyTorch's."""
    del nodes_of(files["decoder"], "LayerNormalization")[0].attribute[:]
    assert match(files, graphs).attributes == ()


def test_matching_leaves_the_model_as_it_was(tiny_model):
    before = {name: tensor.clone() for name, tensor in tiny_model.state_dict().items()}
    for graph in [*build_graphs(tiny_model), *graphs_to_export(tiny_model)]:
        assert used_tensors(graph).tensors
    assert all(torch.equal(tensor, before[name]) for name, tensor in tiny_model.state_dict().items())
    assert not any(module._forward_hooks or module._forward_pre_hooks for module in tiny_model.modules())
    assert all(parameter.device.type == "cpu" for parameter in tiny_model.parameters())
