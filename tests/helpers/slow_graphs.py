"""Graphs that run for a very long time, for tests of interruptions. No bundle with them would be accepted."""

from itertools import pairwise
from pathlib import Path

import onnx
from onnx import TensorProto, helper

from duospacenet.runtime.bundle.manifest import GraphSpec, TensorSpec
from duospacenet.runtime.onnxruntime_session import OnnxruntimeSession
from duospacenet.runtime.session import Session

KINDS = ("endless loop", "long chain")


def slow_session(kind: str) -> Session:
    """A session of onnxruntime with one input `x`, which must not be all zeros for the loop to be endless.

    kind: "endless loop", or "long chain", of operators that take many minutes together.
    """
    return OnnxruntimeSession(*slow_graph(kind))


def slow_graph(kind: str, length: int = 20_000) -> tuple[bytes, GraphSpec, Path]:
    """The first arguments of a session: the graph's content, its tensors, and its path.

    length: number of operators of the long chain.
    """
    size = 1 if kind == "endless loop" else 1024
    nodes, initializers = _loop() if kind == "endless loop" else _chain(length)
    tensors = [helper.make_tensor_value_info(name, TensorProto.FLOAT, [size, size]) for name in ("x", "y")]
    graph = helper.make_graph(nodes, kind, tensors[:1], tensors[1:], initializers)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=10)
    onnx.checker.check_model(model)
    specs = [TensorSpec(name=name, shape=(size, size), dtype="float32") for name in ("x", "y")]
    spec = GraphSpec(file="slow.onnx", sha256="", inputs=(specs[0],), outputs=(specs[1],))
    return model.SerializeToString(), spec, Path("slow.onnx")


def _chain(length: int) -> tuple[list[onnx.NodeProto], list[onnx.TensorProto]]:
    names = ["x", *(f"x{number}" for number in range(length - 1)), "y"]
    nodes = [helper.make_node("MatMul", [a, "x"], [b]) for a, b in pairwise(names)]
    return nodes, []


def _loop() -> tuple[list[onnx.NodeProto], list[onnx.TensorProto]]:
    inputs = {"index": TensorProto.INT64, "go": TensorProto.BOOL, "value": TensorProto.FLOAT}
    outputs = {"go_on": TensorProto.BOOL, "next": TensorProto.FLOAT}
    body = helper.make_graph(
        [helper.make_node("Identity", ["go"], ["go_on"]), helper.make_node("Sin", ["value"], ["next"])],
        "body",
        *(
            [
                helper.make_tensor_value_info(name, kind, [1, 1] if kind == TensorProto.FLOAT else [])
                for name, kind in side.items()
            ]
            for side in (inputs, outputs)
        ),
    )
    nodes = [
        helper.make_node("Cast", ["x"], ["nonzero"], to=TensorProto.BOOL),
        helper.make_node("Squeeze", ["nonzero"], ["go"]),
        helper.make_node("Loop", ["", "go", "x"], ["y"], body=body),
    ]
    return nodes, []
