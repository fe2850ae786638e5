"""Differential fuzzing of the checks of graph files: whatever they accept, protobuf libraries read in the same way.

The oracles are Python's protobuf library (upb) and the C++ parsers of onnx and of onnxruntime. onnxruntime's own parser
is the one that matters, but only the names and shapes of its inputs and outputs can be seen.

The test runs for FUZZ_SECONDS (a minute in CI). FUZZ_SEED=N starts at another seed.
"""

import os
import time
from pathlib import Path
from random import Random

import numpy as np
import onnx
import onnxruntime as ort
import pytest
from google.protobuf.message import DecodeError, Message
from onnx import TensorProto, helper, numpy_helper

from duospacenet.runtime.bundle import graph_file, protobuf
from duospacenet.runtime.bundle.operators import OPERATORS
from duospacenet.runtime.cores import available_cores
from duospacenet.runtime.errors import ArtifactError
from duospacenet.runtime.onnxruntime_session import set_thread_pool_size
from tests.fuzz.protobuf_damage import damage, encode, to_parts

SECONDS = float(os.environ.get("FUZZ_SECONDS", "60"))
FIRST_SEED = int(os.environ.get("FUZZ_SEED", "0"))

# What an exported graph may hold, written once more and independently of the table under test.
PERMITTED = {
    "ModelProto": {"ir_version", "producer_name", "graph", "opset_import"},
    "OperatorSetIdProto": {"domain", "version"},
    "GraphProto": {"node", "name", "initializer", "input", "output", "value_info"},
    "NodeProto": {"input", "output", "name", "op_type", "attribute", "domain"},
    "AttributeProto": {"name", "f", "i", "s", "ints", "type"},
    "TensorProto": {"dims", "data_type", "name", "raw_data", "data_location"},
    "ValueInfoProto": {"name", "type", "metadata_props"},
    "StringStringEntryProto": {"key", "value"},
    "TypeProto": {"tensor_type"},
    "Tensor": {"elem_type", "shape"},
    "TensorShapeProto": {"dim"},
    "Dimension": {"dim_value"},
}


def small_model() -> onnx.ModelProto:
    """A model that onnxruntime runs, with every field that an exported graph has."""
    nodes = [
        helper.make_node("Clip", ["x", "low"], ["a"], name="clip"),
        helper.make_node("Conv", ["a", "w"], ["b"], name="conv", kernel_shape=[1, 1], auto_pad="VALID", group=1),
        helper.make_node("LayerNormalization", ["b", "scale"], ["c"], name="norm", axis=-1, epsilon=1e-3),
        helper.make_node("Relu", ["c"], ["y"], name="relu", domain=""),
    ]
    tensors = [
        numpy_helper.from_array(np.array(0.5, np.float32), "low"),
        numpy_helper.from_array(np.ones((1, 1, 1, 1), np.float32), "w"),
        numpy_helper.from_array(np.ones(2, np.float32), "scale"),
    ]
    x, y, a = (helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, 1, 2, 2]) for name in ("x", "y", "a"))
    a.metadata_props.add(key="key", value="value")
    graph = helper.make_graph(nodes, "graph", [x], [y], tensors, value_info=[a])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=10)
    model.producer_name = "duospacenet"
    return model


def test_an_accepted_graph_file_is_the_same_model_for_every_parser():
    set_thread_pool_size(available_cores())
    intact = small_model()
    parts, counts = to_parts(intact), {True: 0, False: 0}
    assert encode(parts) == intact.SerializeToString()
    assert is_accepted_by_all(encode(parts), 1.0)
    deadline_s, number = time.monotonic() + SECONDS, FIRST_SEED
    while time.monotonic() < deadline_s:
        random = Random(number)
        data = damage(parts, intact.DESCRIPTOR, random)
        try:
            counts[is_accepted_by_all(data, random.random())] += 1
        except Exception as error:
            pytest.fail(f"FUZZ_SEED={number}: {error!r}\nonnx.ModelProto.FromString({data!r})")
        number += 1
    print(f"{number - FIRST_SEED} files, {counts[True]} accepted")
    assert counts[True] > number / 200
    assert counts[False] > number / 5


def is_accepted_by_all(data: bytes, dice: float) -> bool:
    """Compare the parsers on one file. Returns whether the checks accept it.

    dice: a random number from 0 to 1; the slow parsers see a part of the files only.
    """
    ours, theirs = accepted_view(data), parse(data)
    if ours is None:
        is_written_by_library = theirs is not None and without_unknown_fields(theirs) == data
        assert not (is_written_by_library and is_harmless(theirs)), "a harmless file is refused"
        return False
    assert theirs is not None, "a file that the library cannot read is accepted"
    assert ours == view(theirs), "the library reads another model"
    assert is_harmless(theirs), "forbidden content is accepted"
    assert without_unknown_fields(theirs) == theirs.SerializeToString(), "the library finds unknown fields"
    compare_with_onnx(data, theirs)
    if dice < 0.3:
        compare_with_onnxruntime(data, theirs)
    return True


def accepted_view(data: bytes) -> dict | None:
    """The model as the parser under test reads it, or None if the file is refused."""
    try:
        graph_file.check_graph(data, Path("graph.onnx"))
    except ArtifactError:
        return None
    return plain(protobuf.parse(data, graph_file.MODEL, graph_file.MAX_FIELDS))


def plain(value):
    """Fields with bytes for views and without empty lists."""
    if isinstance(value, dict):
        return {number: [plain(item) for item in items] for number, items in value.items()}
    return quiet(bytes(value)) if isinstance(value, memoryview) else value


def quiet(value: bytes) -> bytes:
    """Set the quiet bit of a NaN of 4 bytes, on both sides: Python sets it when it reads a float32."""
    is_nan = len(value) == 4 and bool(np.isnan(np.frombuffer(value, "<f4")[0]))
    return bytes((value[0], value[1], value[2] | 0x40, value[3])) if is_nan else value


def parse(data: bytes) -> onnx.ModelProto | None:
    """The model as the library reads it, or None if the file, or a text in it, is invalid."""
    try:
        model = onnx.ModelProto.FromString(data)
        view(model)
    except DecodeError:
        return None
    return model


def view(message: Message) -> dict:
    """The fields of a library's message by number, in the form of `Fields`. Raises DecodeError for invalid text."""
    fields = {}
    for descriptor, value in message.ListFields():
        items = [value] if isinstance(value, (int, float, str, bytes, Message)) else list(value)
        if descriptor.type == descriptor.TYPE_STRING and not all(isinstance(item, str) for item in items):
            raise DecodeError("the library returns text as bytes if it is not UTF-8")
        fields[descriptor.number] = [view_of_item(item) for item in items]
    return fields


def view_of_item(item):
    if isinstance(item, Message):
        return view(item)
    if isinstance(item, float):
        return quiet(np.float32(item).tobytes())
    if isinstance(item, bytes):
        return quiet(item)
    return item % 2**64 if isinstance(item, int) else item


def without_unknown_fields(model: onnx.ModelProto) -> bytes:
    copy = onnx.ModelProto()
    copy.CopyFrom(model)
    copy.DiscardUnknownFields()
    return copy.SerializeToString()


def is_harmless(model: onnx.ModelProto) -> bool:
    """Whether the library's model holds permitted fields, operators and tensors only."""
    imports = [(entry.domain, entry.version) for entry in model.opset_import]
    return (
        has_permitted_fields(model)
        and len(imports) == 1
        and imports[0][0] in ("", "ai.onnx")
        and imports[0][1] in OPERATORS
        and all(node.domain in ("", "ai.onnx") for node in model.graph.node)
        and all(node.op_type in OPERATORS[imports[0][1]] for node in model.graph.node)
        and all(tensor.data_location == TensorProto.DEFAULT for tensor in model.graph.initializer)
    )


def has_permitted_fields(message: Message) -> bool:
    permitted = PERMITTED[message.DESCRIPTOR.name]
    for descriptor, value in message.ListFields():
        if descriptor.name not in permitted:
            return False
        if descriptor.message_type is not None:
            items = [value] if isinstance(value, Message) else value
            if not all(has_permitted_fields(item) for item in items):
                return False
        elif descriptor.name in ("data_type", "elem_type") and not 0 <= value < 2**31:
            return False
    return True


def compare_with_onnx(data: bytes, expected: onnx.ModelProto) -> None:
    """Compare with the C++ parser of onnx: shape inference reads the bytes, and writes the model again.

    It adds shapes, so only nodes and tensors are compared.
    """
    try:
        parsed = onnx.shape_inference.infer_shapes(data)
    except onnx.shape_inference.InferenceError:
        return  # the file is read, but its shapes contradict each other
    for message in (parsed, expected):
        assert len(message.graph.node) == len(expected.graph.node), "onnx reads another number of nodes"
    for name in ("node", "initializer"):
        pairs = zip(getattr(parsed.graph, name), getattr(expected.graph, name), strict=True)
        assert all(a == b for a, b in pairs), f"onnx reads another {name}"
    assert list(parsed.opset_import) == list(expected.opset_import), "onnx reads other operator sets"
    assert not parsed.functions and not parsed.training_info, "onnx reads functions or training graphs"


def compare_with_onnxruntime(data: bytes, expected: onnx.ModelProto) -> None:
    """Compare with the model that onnxruntime loads, if it loads it: the file may still be an invalid model."""
    options = ort.SessionOptions()
    options.use_per_session_threads = False
    options.log_severity_level = 4
    options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_DISABLE_ALL
    try:
        session = ort.InferenceSession(data, options, providers=["CPUExecutionProvider"], enable_fallback=0)
    except Exception as error:
        assert "protobuf parsing failed" not in str(error), "onnxruntime cannot read an accepted file"
        return
    constants = {tensor.name for tensor in expected.graph.initializer}
    inputs = [value.name for value in expected.graph.input if value.name not in constants]
    assert [value.name for value in session.get_inputs()] == inputs, "onnxruntime reads other inputs"
    assert [value.name for value in session.get_outputs()] == [value.name for value in expected.graph.output]
