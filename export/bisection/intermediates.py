"""The intermediate tensors of a graph, computed in eager mode and named as in the graph's ONNX file."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any

import torch
from numpy.typing import NDArray
from torch import Tensor, fx

_STACK_LINE = re.compile(r'File "(?P<path>[^"]+)", line (?P<line>\d+), in (?P<function>\S+)')


@dataclass(frozen=True)
class Origin:
    """The place in the model that computes a tensor.

    module: path of the innermost module, such as `decoder.layers.0.heads`.
    source: line of code, as `folder/file.py:line, function`.
    """

    module: str
    source: str


class Intermediates:
    """Runs a traced program with torch's operators, node by node, and returns tensors by name.

    The exporter names the tensors of an ONNX file after the nodes of the program. The graph's outputs have their own
    names.
    """

    def __init__(self, program: torch.export.ExportedProgram, outputs: Iterable[str]) -> None:
        """outputs: names of the graph's outputs, in order."""
        self._module = program.module()
        (output_nodes,) = next(node for node in self._module.graph.nodes if node.op == "output").args
        by_output_name = dict(zip(outputs, output_nodes, strict=True))
        nodes = {node.name: node for node in self._module.graph.nodes if node.op == "call_function"}
        self._nodes = {name: node for name, node in (nodes | by_output_name).items() if _is_tensor(node)}

    @property
    def names(self) -> set[str]:
        """Names of all tensors."""
        return set(self._nodes)

    def size_bytes(self, name: str) -> int:
        """Size of a tensor [bytes]."""
        value = self._nodes[name].meta["val"]
        return value.numel() * value.element_size()

    def origin(self, name: str) -> Origin:
        """The place in the model that computes a tensor."""
        meta = self._nodes[name].meta
        stack = [path for path, _ in (meta.get("nn_module_stack") or {}).values()]
        source = _innermost_source_line(meta.get("stack_trace") or "")
        return Origin(stack[-1].removeprefix("model.") if stack else "", source)

    @torch.no_grad()
    def values(self, names: Iterable[str], inputs: Mapping[str, Tensor]) -> dict[str, NDArray]:
        """Compute the tensors `names`; returns them by name.

        inputs: the graph's inputs by name, in the order of the module's arguments.
        """
        node_names = {name: self._nodes[name].name for name in names}
        interpreter = _KeepingInterpreter(self._module, set(node_names.values()))
        # The program was traced with contiguous tensors and may contain views that are legal only for their strides.
        interpreter.run(*(value.contiguous() for value in inputs.values()))
        return {name: interpreter.kept[node].numpy() for name, node in node_names.items()}


class _KeepingInterpreter(fx.Interpreter):
    """Runs a module and keeps the results of chosen nodes. All other tensors are freed after their last use."""

    def __init__(self, module: fx.GraphModule, nodes_to_keep: set[str]) -> None:
        super().__init__(module, garbage_collect_values=True)
        self._nodes_to_keep = nodes_to_keep
        self.kept: dict[str, Tensor] = {}

    def run_node(self, node: fx.Node) -> Any:
        value = super().run_node(node)
        if node.name in self._nodes_to_keep:
            self.kept[node.name] = value
        return value


def _is_tensor(node: fx.Node) -> bool:
    return isinstance(node.meta.get("val"), Tensor)


def _innermost_source_line(stack_trace: str) -> str:
    """The innermost line of a stack trace outside torch, as `folder/file.py:line, function`; empty if there is none."""
    lines = [(PurePath(match["path"]).parts, match) for match in _STACK_LINE.finditer(stack_trace)]
    outside_torch = [(parts, match) for parts, match in lines if "torch" not in parts]
    if not outside_torch:
        return ""
    parts, match = outside_torch[-1]
    return f"{'/'.join(parts[-2:])}:{match['line']}, {match['function']}"
