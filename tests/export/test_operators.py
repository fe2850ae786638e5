"""The list of operators is what the toolkit exports: no operator is missing, and none is superfluous.

The exports of the ablations, of both forms of deformable operators and of VoVNets in the other tests would fail if an
operator were missing, because the parity check loads the bundle.
"""

from dataclasses import replace

import onnx
import pytest

from duospacenet.export.graphs import graphs_to_export
from duospacenet.export.operator_forms import OperatorForms
from duospacenet.export.tracing import trace
from duospacenet.model import PRESETS, DuoSpaceNet, randomise
from duospacenet.model.config import ResNetConfig
from duospacenet.runtime.bundle.operators import DEFAULT_OPSET, EARLIER_OPERATORS, OPERATORS, QUANTIZATION_OPERATORS
from tests.helpers.bundles import GRAPHS
from tests.helpers.exports import share_conversions
from tests.helpers.vovnets import TINY as TINY_VOVNET

DEFORMABLE = replace(
    PRESETS["tiny"],
    preset="tiny-dcn",
    backbone=ResNetConfig("bottleneck", (1, 1, 1, 1), width=8, deformable_stages=(3, 4)),
)
BEV_ATTENTION = replace(PRESETS["tiny-attention"], queries="bev", num_layers=1, num_frames=2)

FORMULAS = OperatorForms("grid-sample", "grid-sample")

# The backbones are those of `base` and `large` in small. The attention over BEV features of past frames has
# an Or, and without PV features a ConstantOfShape.
OTHER_GRAPHS = (
    (DEFORMABLE, "backbone", OperatorForms()),
    (DEFORMABLE, "backbone", FORMULAS),
    (PRESETS["tiny"], "lifter", FORMULAS),
    (PRESETS["tiny"], "decoder", FORMULAS),
    (TINY_VOVNET, "backbone", OperatorForms()),
    (BEV_ATTENTION, "decoder", OperatorForms()),
)


@pytest.fixture(scope="module")
def exported_operators(tiny_bundle, tmp_path_factory) -> set[str]:
    """The operators of every graph of `tiny`, and of all graphs with an operator that `tiny` does not have."""
    paths = [tiny_bundle / f"{name}.onnx" for name in GRAPHS]
    for config, name, forms in OTHER_GRAPHS:
        graph = next(graph for graph in graphs_to_export(randomise(DuoSpaceNet(config)).eval()) if graph.name == name)
        paths.append(tmp_path_factory.mktemp(config.preset) / f"{name}.onnx")
        with share_conversions():
            trace(graph, paths[-1], forms)
    return {node.op_type for path in paths for node in onnx.load(path).graph.node}


def test_the_list_holds_exactly_the_operators_that_are_exported(exported_operators):
    others = QUANTIZATION_OPERATORS | EARLIER_OPERATORS
    assert OPERATORS[DEFAULT_OPSET] - others == exported_operators
    assert not others & exported_operators


def test_all_operators_of_a_list_exist_in_its_operator_set_and_have_no_subgraphs():
    for opset, operators in OPERATORS.items():
        for operator in operators:
            schema = onnx.defs.get_schema(operator, opset)
            assert not any(
                attribute.type in (onnx.defs.OpSchema.AttrType.GRAPH, onnx.defs.OpSchema.AttrType.GRAPHS)
                for attribute in schema.attributes.values()
            )
