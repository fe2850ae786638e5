"""Safety checks of an ONNX file before onnxruntime reads it.

The file is parsed without onnx or protobuf, and no tensor is decoded. The rules:

1. The file holds only the fields that exported graphs have, in strict form (see `protobuf`). So every parser reads the
   same model from it.
2. All operators are in the list of its operator set (see `operators`). They are from ONNX's own domain, none of them
   runs a subgraph, and there are no functions. So a run ends, and the same input gives the same output.
3. Every tensor is stored in the file itself. External data could name any file.
4. The file size, the number of nodes and the number of fields are limited.
"""

from pathlib import Path
from typing import Any

from ..errors import ArtifactError
from ..printable import shortened
from .operators import OPERATORS
from .protobuf import (
    Fields,
    MessageType,
    ProtobufError,
    data,
    float32,
    int32,
    int64,
    parse,
    submessage,
    text,
)

MAX_FILE_BYTES = 2**31 - 1  # the limit of protobuf
MAX_NODES = 50_000  # the decoder of the largest preset has a few thousand
MAX_FIELDS = 500_000  # the decoder of nano has 30,000

ONNX_DOMAINS = ("", "ai.onnx")  # both names mean ONNX's own domain
_ORT_MARK = b"ORTM"  # onnxruntime reads a file with these bytes 4 to 7 as a flatbuffer

MODEL_GRAPH, MODEL_OPSETS, MODEL_TRAINING, MODEL_FUNCTIONS = 7, 8, 20, 25
OPSET_DOMAIN, OPSET_VERSION = 1, 2
GRAPH_NODES, GRAPH_INITIALIZERS, GRAPH_SPARSE_INITIALIZERS = 1, 5, 15
NODE_OPERATOR, NODE_ATTRIBUTES, NODE_DOMAIN = 4, 5, 7
ATTRIBUTE_TENSORS, ATTRIBUTE_GRAPHS, ATTRIBUTE_SPARSE_TENSORS = (5, 10), (6, 11), (22, 23)
TENSOR_EXTERNAL_DATA, TENSOR_DATA_LOCATION = 13, 14

# The messages of onnx.proto with the fields that exported graphs have. Fields of the type `data` that hold a message
# are forbidden by a rule below. They are listed here so that the rule can name them.
_ENTRY = MessageType("StringStringEntryProto", {1: text("key"), 2: text("value")})
_DIMENSION = MessageType("Dimension", {1: int64("dim_value")})
_SHAPE = MessageType("TensorShapeProto", {1: submessage("dim", _DIMENSION, repeated=True)})
_TENSOR_TYPE = MessageType("TypeProto.Tensor", {1: int32("elem_type"), 2: submessage("shape", _SHAPE)})
_TYPE = MessageType("TypeProto", {1: submessage("tensor_type", _TENSOR_TYPE)})
_VALUE_INFO = MessageType(
    "ValueInfoProto",
    {1: text("name"), 2: submessage("type", _TYPE), 4: submessage("metadata_props", _ENTRY, repeated=True)},
)
_TENSOR = MessageType(
    "TensorProto",
    {
        1: int64("dims", repeated=True),
        2: int32("data_type"),
        8: text("name"),
        9: data("raw_data"),
        TENSOR_EXTERNAL_DATA: data("external_data", repeated=True),
        TENSOR_DATA_LOCATION: int64("data_location"),
    },
)
_ATTRIBUTE = MessageType(
    "AttributeProto",
    {
        1: text("name"),
        2: float32("f"),
        3: int64("i"),
        4: data("s"),
        8: int64("ints", repeated=True),
        20: int32("type", largest=14),
        5: data("t"),
        10: data("tensors", repeated=True),
        6: data("g"),
        11: data("graphs", repeated=True),
        22: data("sparse_tensor"),
        23: data("sparse_tensors", repeated=True),
    },
)
_NODE = MessageType(
    "NodeProto",
    {
        1: text("input", repeated=True),
        2: text("output", repeated=True),
        3: text("name"),
        NODE_OPERATOR: text("op_type"),
        NODE_ATTRIBUTES: submessage("attribute", _ATTRIBUTE, repeated=True),
        NODE_DOMAIN: text("domain"),
    },
)
_GRAPH = MessageType(
    "GraphProto",
    {
        GRAPH_NODES: submessage("node", _NODE, repeated=True),
        2: text("name"),
        GRAPH_INITIALIZERS: submessage("initializer", _TENSOR, repeated=True),
        11: submessage("input", _VALUE_INFO, repeated=True),
        12: submessage("output", _VALUE_INFO, repeated=True),
        13: submessage("value_info", _VALUE_INFO, repeated=True),
        GRAPH_SPARSE_INITIALIZERS: data("sparse_initializer", repeated=True),
    },
)
_OPSET = MessageType("OperatorSetIdProto", {OPSET_DOMAIN: text("domain"), OPSET_VERSION: int64("version")})
MODEL = MessageType(
    "ModelProto",
    {
        1: int64("ir_version"),
        2: text("producer_name"),
        MODEL_GRAPH: submessage("graph", _GRAPH),
        MODEL_OPSETS: submessage("opset_import", _OPSET, repeated=True),
        MODEL_TRAINING: data("training_info", repeated=True),
        MODEL_FUNCTIONS: data("functions", repeated=True),
    },
)


class _RuleViolation(Exception):
    """The file breaks a rule. The message names the rule and what was found."""


def check_graph(content: bytes, path: Path) -> dict[str, int]:
    """Check a graph file by the rules of this module and return its operator-set version by domain ("" is ONNX's).

    content: all bytes of the file. path: its name, for messages.
    Raises ArtifactError, naming the file and what was found in it.
    """
    try:
        if not 0 < len(content) <= MAX_FILE_BYTES:
            raise _RuleViolation(f"expected an ONNX file of 1 to {MAX_FILE_BYTES} bytes; got {len(content)}.")
        if content[4:8] == _ORT_MARK:
            raise _RuleViolation("expected an ONNX file; got the mark of a model in ORT format.")
        return _check_model(parse(content, MODEL, MAX_FIELDS))
    except ProtobufError as error:
        message = f"expected an ONNX file as this toolkit writes it; got {error}."
    except _RuleViolation as violation:
        message = str(violation)
    raise ArtifactError(f"{path}: {message} Export again, or ask where the file comes from.") from None


def _check_model(model: Fields) -> dict[str, int]:
    """Check a parsed model by the rules. Returns its operator-set version by domain."""
    for number, kind in ((MODEL_FUNCTIONS, "functions"), (MODEL_TRAINING, "training graphs")):
        if number in model:
            raise _RuleViolation(f"expected plain operators only; got {kind}.")
    opset = _opset(model.get(MODEL_OPSETS, []))
    for graph in model.get(MODEL_GRAPH, []):
        _check_graph(graph, opset)
    return {"": opset}


def _opset(imports: list[Fields]) -> int:
    """Return the version of ONNX's operator set. There must be no other operator set."""
    for entry in imports:
        _check_domain(_first(entry, OPSET_DOMAIN, ""))
    versions = [_first(entry, OPSET_VERSION, 0) for entry in imports]
    if len(versions) != 1 or versions[0] not in OPERATORS:
        expected = f"{min(OPERATORS)} to {max(OPERATORS)}"
        raise _RuleViolation(f"expected one operator set of version {expected}; got {shortened(versions)}.")
    return int(versions[0])


def _check_graph(graph: Fields, opset: int) -> None:
    nodes = graph.get(GRAPH_NODES, [])
    if len(nodes) > MAX_NODES:
        raise _RuleViolation(f"expected at most {MAX_NODES} nodes; got {len(nodes)}.")
    for node in nodes:
        _check_node(node, opset)
    if GRAPH_SPARSE_INITIALIZERS in graph:
        raise _RuleViolation("expected dense tensors; got a sparse initializer.")
    for tensor in graph.get(GRAPH_INITIALIZERS, []):
        # Any location but 0 is refused, also one that a parser would shorten to 32 bits.
        if TENSOR_EXTERNAL_DATA in tensor or _first(tensor, TENSOR_DATA_LOCATION, 0) != 0:
            raise _RuleViolation("expected every tensor in the file itself; got a tensor with external data.")


def _check_node(node: Fields, opset: int) -> None:
    operator = _first(node, NODE_OPERATOR, "")
    _check_domain(_first(node, NODE_DOMAIN, ""))
    if operator not in OPERATORS[opset]:
        raise _RuleViolation(
            f"expected only the operators that duospacenet exports; got {operator[:40]!r}, which is not among them."
        )
    for attribute in node.get(NODE_ATTRIBUTES, []):
        for kind, numbers in (
            ("a subgraph", ATTRIBUTE_GRAPHS),
            ("a tensor", ATTRIBUTE_TENSORS),
            ("a sparse tensor", ATTRIBUTE_SPARSE_TENSORS),
        ):
            if any(number in attribute for number in numbers):
                raise _RuleViolation(f"expected numbers and text as attributes; got {kind} at operator {operator}.")


def _check_domain(domain: str) -> None:
    if domain not in ONNX_DOMAINS:
        raise _RuleViolation(f"expected ONNX's own operators only; got operators of the domain {domain[:40]!r}.")


def _first(fields: Fields, number: int, default: Any) -> Any:
    """Return the value of a field that occurs at most once."""
    return fields.get(number, [default])[0]
