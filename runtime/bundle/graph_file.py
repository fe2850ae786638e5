"""Safety checks of an ONNX file before onnxruntime opens it.

The protobuf messages are read in place, and no tensor is decoded. The rules:

1. Every tensor is stored in the file itself, in subgraphs and attributes too. External data could name any file.
2. All operators are from ONNX's own domain, and there are no functions. The ONNX standard defines their meaning.
3. The file size, the number of nodes and the depth of subgraphs are limited.

Field numbers are those of onnx.proto. Protobuf merges a field that appears twice, so every occurrence is checked.
"""

import mmap
from collections.abc import Iterator
from pathlib import Path

from ..errors import ArtifactError

MAX_FILE_BYTES = 2**31 - 1  # the limit of protobuf
MAX_NODES = 50_000  # the decoder of the largest preset has a few thousand
MAX_SUBGRAPH_DEPTH = 8  # levels of subgraphs within subgraphs

ONNX_DOMAINS = (b"", b"ai.onnx")
MODEL_GRAPH, MODEL_OPSET, MODEL_TRAINING, MODEL_FUNCTION = 7, 8, 20, 25
OPSET_DOMAIN, OPSET_VERSION = 1, 2
GRAPH_NODE, GRAPH_INITIALIZER, GRAPH_SPARSE_INITIALIZER = 1, 5, 15
NODE_ATTRIBUTE, NODE_DOMAIN = 5, 7
ATTRIBUTE_TENSORS, ATTRIBUTE_GRAPHS, ATTRIBUTE_SPARSE_TENSORS = (5, 10), (6, 11), (22, 23)
TENSOR_EXTERNAL_DATA, TENSOR_DATA_LOCATION = 13, 14
SPARSE_VALUES, SPARSE_INDICES = 1, 2

VARINT, FIXED64, BYTES, FIXED32 = 0, 1, 2, 5

Field = tuple[int, int | memoryview]  # field number; the value of a number, or the bytes of anything else


class _RuleViolation(Exception):
    """The file breaks a rule. The message names the rule and what was found."""


def check_size(path: Path) -> None:
    """Check the size of a graph file without reading it. Raises ArtifactError if it is empty or too large."""
    size = path.stat().st_size
    if not 0 < size <= MAX_FILE_BYTES:
        raise ArtifactError(f"{path}: expected an ONNX file of 1 to {MAX_FILE_BYTES} bytes; got {size}. Export again.")


def check_graph_file(path: Path) -> dict[str, int]:
    """Check a graph file by the rules of this module and return its operator-set version by domain ("" is ONNX's).

    Raises ArtifactError, naming the file and what was found in it.
    """
    checker = _GraphChecker()
    with path.open("rb") as file:
        content = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)  # closed when its last view is deleted
    try:
        checker.check_model(memoryview(content))
    except _RuleViolation as violation:
        raise ArtifactError(f"{path}: {violation} Export again, or ask where the file comes from.") from None
    return checker.opsets


class _GraphChecker:
    """Checks a model in one pass. Counts the nodes and collects the operator-set versions."""

    def __init__(self) -> None:
        self._nodes = 0
        self.opsets: dict[str, int] = {}

    def check_model(self, data: memoryview) -> None:
        for number, value in _fields(data):
            if number == MODEL_GRAPH:
                self._graph(_message(value), depth=0)
            elif number == MODEL_OPSET:
                self._opset(_message(value))
            elif number in (MODEL_TRAINING, MODEL_FUNCTION):
                kind = "functions" if number == MODEL_FUNCTION else "training graphs"
                raise _RuleViolation(f"expected plain operators only; got {kind}.")

    def _opset(self, data: memoryview) -> None:
        domain, version = b"", 0
        for number, value in _fields(data):
            if number == OPSET_DOMAIN:
                domain = bytes(_message(value))
            elif number == OPSET_VERSION and isinstance(value, int):
                version = value
        _check_domain(domain)
        self.opsets[""] = version

    def _graph(self, data: memoryview, depth: int) -> None:
        if depth > MAX_SUBGRAPH_DEPTH:
            raise _RuleViolation(f"expected subgraphs at most {MAX_SUBGRAPH_DEPTH} deep; got more.")
        for number, value in _fields(data):
            if number == GRAPH_NODE:
                self._node(_message(value), depth)
            elif number == GRAPH_INITIALIZER:
                _check_tensor(_message(value))
            elif number == GRAPH_SPARSE_INITIALIZER:
                _check_sparse_tensor(_message(value))

    def _node(self, data: memoryview, depth: int) -> None:
        self._nodes += 1
        if self._nodes > MAX_NODES:
            raise _RuleViolation(f"expected at most {MAX_NODES} nodes; got more.")
        for number, value in _fields(data):
            if number == NODE_DOMAIN:
                _check_domain(bytes(_message(value)))
            elif number == NODE_ATTRIBUTE:
                self._attribute(_message(value), depth)

    def _attribute(self, data: memoryview, depth: int) -> None:
        for number, value in _fields(data):
            if number in ATTRIBUTE_TENSORS:
                _check_tensor(_message(value))
            elif number in ATTRIBUTE_GRAPHS:
                self._graph(_message(value), depth + 1)
            elif number in ATTRIBUTE_SPARSE_TENSORS:
                _check_sparse_tensor(_message(value))


def _check_domain(domain: bytes) -> None:
    if domain not in ONNX_DOMAINS:
        raise _RuleViolation(
            f"expected ONNX's own operators only; got operators of the domain {domain.decode(errors='replace')!r}."
        )


def _check_tensor(data: memoryview) -> None:
    for number, value in _fields(data):
        if number == TENSOR_EXTERNAL_DATA or (number == TENSOR_DATA_LOCATION and value != 0):
            raise _RuleViolation("expected every tensor in the file itself; got a tensor with external data.")


def _check_sparse_tensor(data: memoryview) -> None:
    for number, value in _fields(data):
        if number in (SPARSE_VALUES, SPARSE_INDICES):
            _check_tensor(_message(value))


def _message(value: int | memoryview) -> memoryview:
    if isinstance(value, int):
        raise _RuleViolation("expected an ONNX file; got a number in place of a message.")
    return value


def _fields(data: memoryview) -> Iterator[Field]:
    """Yield the fields of a protobuf message, in the order of the file."""
    offset = 0
    while offset < len(data):
        key, offset = _varint(data, offset)
        number, kind = key >> 3, key & 7
        if kind == VARINT:
            value, offset = _varint(data, offset)
            yield number, value
            continue
        size, offset = _varint(data, offset) if kind == BYTES else ({FIXED64: 8, FIXED32: 4}.get(kind, -1), offset)
        if size < 0 or offset + size > len(data):
            raise _RuleViolation("expected an ONNX file; got bytes that are not a protobuf message.")
        yield number, data[offset : offset + size]
        offset += size


def _varint(data: memoryview, offset: int) -> tuple[int, int]:
    """Decode the variable-length integer at `offset`. Returns it and the offset behind it."""
    value = shift = 0
    # Seven bits per byte, lowest first; 64 bits take at most 10 bytes.
    while offset < len(data) and shift < 70:
        byte = data[offset]
        offset += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, offset
        shift += 7
    raise _RuleViolation("expected an ONNX file; got bytes that are not a protobuf message.")
