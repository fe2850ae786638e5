"""Rewrite a float32 graph: QuantizeLinear and DequantizeLinear around the operators of chosen blocks."""

import copy
from collections.abc import Collection, Sequence
from pathlib import Path

import onnx
from onnx import numpy_helper
from onnxruntime.quantization import QDQQuantizer, QuantType, TensorsData
from onnxruntime.quantization.quant_utils import add_infer_metadata

from ...runtime.bundle.graph_file import check_graph
from ...runtime.bundle.quantization_record import QuantizationRecipe
from ...runtime.versions import library_versions
from .blocks import CONVOLUTIONAL, OPERATORS, blocks_of


def recipe() -> QuantizationRecipe:
    """The recipe of this module, for the manifest."""
    return QuantizationRecipe(
        form="QDQ",
        activations="uint8",
        weights="int8 per channel",
        operators=tuple(dict.fromkeys(name for names in OPERATORS.values() for name in names)),
        calibration="min-max",
        onnxruntime=library_versions(("onnxruntime",))["onnxruntime"],
    )


def quantize_graph(
    graph: Path, ranges: TensorsData, blocks: Collection[str], operators: Sequence[str] = CONVOLUTIONAL
) -> bytes:
    """The content of the quantized graph file.

    graph: the file of the float32 graph.
    ranges: from the calibration of this graph.
    blocks: names of the blocks to quantize; those of other graphs are ignored.
    operators: those that may be quantized.

    An operator keeps its name and its tensors keep theirs. A Relu between two quantized tensors is left out, because
    its output has the zero point 0, which clips in the same way.
    """
    # onnxruntime needs the types of all tensors. Its own preprocessing would also optimise the graph, and then the
    # parity check could no longer compare it with a new export.
    model = onnx.shape_inference.infer_shapes(onnx.load_model(graph))
    # Otherwise onnxruntime infers the shapes again, through a file in the folder for temporary files. Its name is
    # uuid.uuid1(), which opens an internet socket to read the address of the network card.
    add_infer_metadata(model)
    nodes = [name for block, names in blocks_of(model.graph, operators).items() if block in blocks for name in names]
    if nodes:
        quantizer = QDQQuantizer(
            model,
            True,  # one scale per channel of a weight
            False,  # the whole range of int8
            QuantType.QInt8,
            QuantType.QUInt8,
            copy.deepcopy(ranges),
            nodes,
            [],
            list(operators),
            {},
        )
        quantizer.quantize_model()
        quantizer.model.topological_sort()
        model = quantizer.model.model
    content = _in_exported_form(model, onnx.load_model(graph)).SerializeToString(deterministic=True)
    check_graph(content, graph)
    return content


def _in_exported_form(model: onnx.ModelProto, original: onnx.ModelProto) -> onnx.ModelProto:
    """The model with only those fields that exported graph files have."""
    tidy = onnx.ModelProto()
    tidy.ir_version, tidy.producer_name = original.ir_version, original.producer_name
    tidy.graph.CopyFrom(model.graph)
    # onnxruntime adds imports of its operator sets, which no operator uses.
    tidy.opset_import.extend(entry for entry in original.opset_import if not entry.domain)
    del tidy.graph.value_info[:], tidy.graph.initializer[:], tidy.graph.input[:], tidy.graph.output[:]
    tidy.graph.input.extend(original.graph.input)
    tidy.graph.output.extend(original.graph.output)
    for tensor in model.graph.initializer:
        # onnxruntime stores some tensors as lists of numbers.
        tidy.graph.initializer.append(numpy_helper.from_array(numpy_helper.to_array(tensor), tensor.name))
    tidy.graph.ClearField("doc_string")
    onnx.checker.check_model(tidy, full_check=True)
    return tidy
