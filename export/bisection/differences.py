"""Differences between a piece of a graph file and the same piece of a fresh export, as sentences."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from onnx import NodeProto, helper

from .pieces import CutGraph


def differences(file: CutGraph, fresh: CutGraph, tensor: str) -> list[str]:
    """Compare the nodes that compute `tensor` in `file` and in `fresh`. Returns one line per difference."""
    if tensor not in fresh.pieces:
        return ["a fresh export has no such tensor"]
    file_piece, fresh_piece = file.pieces[tensor], fresh.pieces[tensor]
    if file_piece.operators != fresh_piece.operators:
        return [f"computed by {_join(file_piece.operators)}; a fresh export uses {_join(fresh_piece.operators)}"]
    lines: list[str] = []
    # Tensors inside a piece can have other names in the fresh export. This maps their names to the file's names.
    file_names: dict[str, str] = {}
    for node, fresh_node in zip(file_piece.nodes, fresh_piece.nodes, strict=True):
        expected = [file_names.get(name, name) for name in fresh_node.input]
        lines += [
            *_attribute_differences(node, fresh_node),
            *_input_differences(file, fresh, node, fresh_node, expected),
        ]
        file_names |= zip(fresh_node.output, node.output, strict=False)
    return list(dict.fromkeys(lines))


def _attribute_differences(node: NodeProto, fresh: NodeProto) -> Iterator[str]:
    actual, expected = _attributes(node), _attributes(fresh)
    for name in sorted(actual.keys() | expected.keys()):
        if actual.get(name) != expected.get(name):
            values = _attribute_text(actual, name), _attribute_text(expected, name)
            yield f"{node.op_type}: attribute {name} is {values[0]}; in a fresh export it is {values[1]}"


def _attributes(node: NodeProto) -> dict[str, object]:
    return {attribute.name: helper.get_attribute_value(attribute) for attribute in node.attribute}


def _attribute_text(values: dict[str, object], name: str) -> str:
    value = values.get(name, "missing")
    return value.decode() if isinstance(value, bytes) else str(value)


def _input_differences(
    file: CutGraph, fresh: CutGraph, node: NodeProto, fresh_node: NodeProto, expected: list[str]
) -> Iterator[str]:
    """Differences between the inputs of two nodes.

    expected: the inputs of `fresh_node`, by their names in `file`.
    """
    actual = list(node.input)
    if len(actual) != len(expected):
        yield f"{node.op_type} has {len(actual)} inputs; in a fresh export it has {len(expected)}"
    elif actual != expected and sorted(actual) == sorted(expected):
        order = ", ".join(str(expected.index(name)) for name in actual)
        yield f"{node.op_type}: the inputs are swapped; numbered as in a fresh export, their order is {order}"
    else:
        for name, fresh_name, expected_name in zip(actual, fresh_node.input, expected, strict=True):
            constants = file.constant(name), fresh.constant(fresh_name)
            yield from _input_difference(node.op_type, name, expected_name, *constants)


def _input_difference(
    operator: str, actual: str, expected: str, constant: NDArray | None, fresh_constant: NDArray | None
) -> Iterator[str]:
    if constant is not None and fresh_constant is not None:
        yield from _constant_difference(actual, constant, fresh_constant)
    elif constant is not None:
        yield f"{operator} reads the constant {actual}; in a fresh export it reads {expected}"
    elif actual != expected:
        yield f"{operator} reads {actual}; in a fresh export it reads {expected}"


def _constant_difference(name: str, actual: NDArray, expected: NDArray) -> Iterator[str]:
    if actual.shape != expected.shape or actual.dtype != expected.dtype:
        types = f"{actual.dtype} {actual.shape}", f"{expected.dtype} {expected.shape}"
        yield f"constant {name}: the type is {types[0]}; in a fresh export it is {types[1]}"
        return
    different = ~np.isclose(actual, expected, rtol=1e-6, atol=0, equal_nan=True)
    if not different.any():
        return
    if not np.isfinite(actual[different]).all():
        yield f"constant {name}: {int((~np.isfinite(actual)).sum())} of {actual.size} numbers are not finite"
        return
    index = np.unravel_index(np.argmax(np.abs(actual.astype(np.float64) - expected)), actual.shape)
    place = f" at [{', '.join(map(str, index))}]" if index else ""
    yield (
        f"constant {name}: {int(different.sum())} of {actual.size} numbers differ from a fresh export; "
        f"the largest difference is{place}: {actual[index]:.6g} instead of {expected[index]:.6g}"
    )


def _join(operators: tuple[str, ...]) -> str:
    return ", ".join(operators) if len(operators) < 6 else f"{len(operators)} operators ending with {operators[-1]}"
