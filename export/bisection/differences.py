"""How a piece of a graph file differs from the same piece of a fresh export, in words."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from onnx import NodeProto, helper

from .pieces import CutGraph


def differences(file: CutGraph, fresh: CutGraph, tensor: str) -> list[str]:
    """What to look at in the file where it computes `tensor`; empty where the two are alike."""
    if tensor not in fresh.pieces:
        return ["a fresh export has no such tensor"]
    old, new = fresh.pieces[tensor], file.pieces[tensor]
    if old.operators != new.operators:
        return [f"computed by {_list(new.operators)}, in a fresh export by {_list(old.operators)}"]
    lines: list[str] = []
    names: dict[str, str] = {}  # the file's, of what the fresh nodes so far have made: the rest means the same in both
    for node, fresh_node in zip(new.nodes, old.nodes, strict=True):
        expected = [names.get(name, name) for name in fresh_node.input]
        lines += [*_attributes(node, fresh_node), *_inputs(file, fresh, node, fresh_node, expected)]
        names |= zip(fresh_node.output, node.output, strict=False)
    return list(dict.fromkeys(lines))


def _attributes(node: NodeProto, fresh: NodeProto) -> Iterator[str]:
    got, expected = _values(node), _values(fresh)
    for name in sorted(got.keys() | expected.keys()):
        if got.get(name) != expected.get(name):
            values = _attribute(got, name), _attribute(expected, name)
            yield f"{node.op_type}: attribute {name} is {values[0]}, in a fresh export {values[1]}"


def _values(node: NodeProto) -> dict[str, object]:
    return {attribute.name: helper.get_attribute_value(attribute) for attribute in node.attribute}


def _attribute(values: dict[str, object], name: str) -> str:
    value = values.get(name, "left out")
    return value.decode() if isinstance(value, bytes) else str(value)


def _inputs(
    file: CutGraph, fresh: CutGraph, node: NodeProto, fresh_node: NodeProto, expected: list[str]
) -> Iterator[str]:
    """expected: what the node should read, by the names that the file has for it."""
    got = list(node.input)
    if len(got) != len(expected):
        yield f"{node.op_type} takes {len(got)} inputs, in a fresh export {len(expected)}"
    elif got != expected and sorted(got) == sorted(expected):
        order = ", ".join(str(expected.index(name)) for name in got)
        yield f"{node.op_type} reads its inputs in another order: those of a fresh export, counted from 0, as {order}"
    else:
        for name, fresh_name, wanted in zip(got, fresh_node.input, expected, strict=True):
            yield from _input(node.op_type, name, wanted, file.constant(name), fresh.constant(fresh_name))


def _input(
    operator: str, got: str, expected: str, constant: NDArray | None, fresh_constant: NDArray | None
) -> Iterator[str]:
    if constant is not None and fresh_constant is not None:
        yield from _constants(got, constant, fresh_constant)
    elif constant is not None:
        yield f"{operator} reads the constant {got}, in a fresh export {expected}"
    elif got != expected:
        yield f"{operator} reads {got}, in a fresh export {expected}"


def _constants(name: str, got: NDArray, expected: NDArray) -> Iterator[str]:
    if got.shape != expected.shape or got.dtype != expected.dtype:
        yield f"constant {name}: {got.dtype} {got.shape}, in a fresh export {expected.dtype} {expected.shape}"
        return
    off = ~np.isclose(got, expected, rtol=1e-6, atol=0, equal_nan=True)
    if not off.any():
        return
    if not np.isfinite(got[off]).all():
        yield f"constant {name}: {int((~np.isfinite(got)).sum())} of {got.size} numbers are not finite"
        return
    at = np.unravel_index(np.argmax(np.abs(got.astype(np.float64) - expected)), got.shape)
    place = f"[{', '.join(map(str, at))}]" if at else ""
    yield (
        f"constant {name}: {int(off.sum())} of {got.size} numbers differ from a fresh export; "
        f"most at {place}: {got[at]:.6g}, not {expected[at]:.6g}"
    )


def _list(operators: tuple[str, ...]) -> str:
    return ", ".join(operators) if len(operators) < 6 else f"{len(operators)} operators, the last {operators[-1]}"
