"""What an ONNX file may hold, looked at before onnxruntime sees it: the protobuf is walked, and nothing is decoded.

1. Every tensor lies in the file itself, in subgraphs and attributes too: external data could be any file of the disk.
2. Operators come from ONNX's own domain, and there are no functions: what they do is written down.
3. File, nodes and depth are of a size that a DuoSpaceNet has.

Field numbers are those of onnx.proto; a field that appears twice is walked twice, as protobuf would merge it.
"""

import mmap
from collections.abc import Iterator
from pathlib import Path

from ..errors import ArtifactError

MAX_FILE_BYTES = 2**31 - 1  # what protobuf can hold
MAX_NODES = 50_000  # the largest preset's decoder has some thousands
MAX_SUBGRAPH_DEPTH = 8  # subgraphs within subgraphs

ONNX_DOMAINS = (b"", b"ai.onnx")
MODEL_GRAPH, MODEL_OPSET, MODEL_TRAINING, MODEL_FUNCTION = 7, 8, 20, 25
OPSET_DOMAIN, OPSET_VERSION = 1, 2
GRAPH_NODE, GRAPH_INITIALIZER, GRAPH_SPARSE_INITIALIZER = 1, 5, 15
NODE_ATTRIBUTE, NODE_DOMAIN = 5, 7
ATTRIBUTE_TENSORS, ATTRIBUTE_GRAPHS, ATTRIBUTE_SPARSE_TENSORS = (5, 10), (6, 11), (22, 23)
TENSOR_EXTERNAL_DATA, TENSOR_DATA_LOCATION = 13, 14
SPARSE_VALUES, SPARSE_INDICES = 1, 2

VARINT, FIXED64, BYTES, FIXED32 = 0, 1, 2, 5

Field = tuple[int, int | memoryview]  # a field's number, and its value or its bytes


class _Refused(Exception):
    """Why a file is refused."""


def check_size(path: Path) -> None:
    """Raises ArtifactError for a file that is too large to be a graph, before anybody reads it."""
    size = path.stat().st_size
    if not 0 < size <= MAX_FILE_BYTES:
        raise ArtifactError(f"{path}: expected an ONNX file of 1 to {MAX_FILE_BYTES} bytes; got {size}. Export again.")


def check_graph_file(path: Path) -> dict[str, int]:
    """The operators' version by domain, "" being ONNX's own.

    Raises ArtifactError, naming the file and what it holds, for one that breaks a rule of this module.
    """
    walk = _Walk()
    with path.open("rb") as file:
        content = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)  # it closes with the last view of it
    try:
        walk.model(memoryview(content))
    except _Refused as refusal:
        raise ArtifactError(f"{path}: {refusal} Export again, or ask where the file comes from.") from None
    return walk.opsets


class _Walk:
    """One pass over a model; counts its nodes and notes its operator sets."""

    def __init__(self) -> None:
        self._nodes = 0
        self.opsets: dict[str, int] = {}

    def model(self, data: memoryview) -> None:
        for number, value in _fields(data):
            if number == MODEL_GRAPH:
                self._graph(_message(value), depth=0)
            elif number == MODEL_OPSET:
                self._opset(_message(value))
            elif number in (MODEL_TRAINING, MODEL_FUNCTION):
                kind = "functions" if number == MODEL_FUNCTION else "training graphs"
                raise _Refused(f"expected plain operators; got {kind} of its own.")

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
            raise _Refused(f"expected subgraphs at most {MAX_SUBGRAPH_DEPTH} deep; got more.")
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
            raise _Refused(f"expected at most {MAX_NODES} nodes; got more.")
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
        raise _Refused(f"expected ONNX's own operators; got some of the domain {domain.decode(errors='replace')!r}.")


def _check_tensor(data: memoryview) -> None:
    for number, value in _fields(data):
        if number == TENSOR_EXTERNAL_DATA or (number == TENSOR_DATA_LOCATION and value != 0):
            raise _Refused("expected every tensor in the file itself; got one with external data.")


def _check_sparse_tensor(data: memoryview) -> None:
    for number, value in _fields(data):
        if number in (SPARSE_VALUES, SPARSE_INDICES):
            _check_tensor(_message(value))


def _message(value: int | memoryview) -> memoryview:
    if isinstance(value, int):
        raise _Refused("expected an ONNX file; got a number where a message belongs.")
    return value


def _fields(data: memoryview) -> Iterator[Field]:
    """The fields of a protobuf message, in the order of the file."""
    at = 0
    while at < len(data):
        key, at = _varint(data, at)
        number, kind = key >> 3, key & 7
        if kind == VARINT:
            value, at = _varint(data, at)
            yield number, value
            continue
        size, at = _varint(data, at) if kind == BYTES else ({FIXED64: 8, FIXED32: 4}.get(kind, -1), at)
        if size < 0 or at + size > len(data):
            raise _Refused("expected an ONNX file; got bytes that are none.")
        yield number, data[at : at + size]
        at += size


def _varint(data: memoryview, at: int) -> tuple[int, int]:
    """The number that starts at `at`, and where it ends."""
    value = shift = 0
    while at < len(data) and shift < 70:
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
        shift += 7
    raise _Refused("expected an ONNX file; got bytes that are none.")
