"""Every tensor that a graph's module computes on the way, in eager torch, by the name the graph's file has for it."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any

import torch
from numpy.typing import NDArray
from torch import Tensor, fx

_SOURCE = re.compile(r'File "(?P<path>[^"]+)", line (?P<line>\d+), in (?P<function>\S+)')


@dataclass(frozen=True)
class Origin:
    """Where in the model a tensor is computed: the innermost module's path, and its line of source."""

    module: str
    source: str


class Intermediates:
    """Runs a traced program node by node, with torch's own operators, and keeps what is asked for.

    The names are those of the program's nodes, after which the exporter names the tensors of a file; what a graph
    gives has the graph's own names.
    """

    def __init__(self, program: torch.export.ExportedProgram, outputs: Iterable[str]) -> None:
        """outputs: the names of what the graph gives, in its order."""
        self._module = program.module()
        (given,) = next(node for node in self._module.graph.nodes if node.op == "output").args
        named = dict(zip(outputs, given, strict=True))
        nodes = {node.name: node for node in self._module.graph.nodes if node.op == "call_function"}
        self._nodes = {name: node for name, node in (nodes | named).items() if _is_tensor(node)}

    @property
    def names(self) -> set[str]:
        """All tensors there are."""
        return set(self._nodes)

    def size_bytes(self, name: str) -> int:
        """How much memory a tensor takes."""
        value = self._nodes[name].meta["val"]
        return value.numel() * value.element_size()

    def origin(self, name: str) -> Origin:
        """Where a tensor comes from; paths start at the model."""
        meta = self._nodes[name].meta
        stack = [path for path, _ in (meta.get("nn_module_stack") or {}).values()]
        return Origin(stack[-1].removeprefix("model.") if stack else "", _last_line(meta.get("stack_trace") or ""))

    @torch.no_grad()
    def values(self, names: Iterable[str], inputs: Mapping[str, Tensor]) -> dict[str, NDArray]:
        """These tensors, by name, when the module takes `inputs`, which lie in the order of its arguments."""
        wanted = {name: self._nodes[name].name for name in names}
        keeper = _Keeper(self._module, set(wanted.values()))
        # A program may look at a tensor by its strides, which were a plain one's when it was traced.
        keeper.run(*(value.contiguous() for value in inputs.values()))
        return {name: keeper.kept[node].numpy() for name, node in wanted.items()}


class _Keeper(fx.Interpreter):
    """Drops a tensor after its last use, unless it was asked for."""

    def __init__(self, module: fx.GraphModule, wanted: set[str]) -> None:
        super().__init__(module, garbage_collect_values=True)
        self._wanted = wanted
        self.kept: dict[str, Tensor] = {}

    def run_node(self, node: fx.Node) -> Any:
        value = super().run_node(node)
        if node.name in self._wanted:
            self.kept[node.name] = value
        return value


def _is_tensor(node: fx.Node) -> bool:
    return isinstance(node.meta.get("val"), Tensor)


def _last_line(stack_trace: str) -> str:
    """The innermost line of a stack trace that is not torch's own, as `folder/file.py:line, function`."""
    lines = [(PurePath(found["path"]).parts, found) for found in _SOURCE.finditer(stack_trace)]
    ours = [(parts, found) for parts, found in lines if "torch" not in parts]
    if not ours:
        return ""
    parts, found = ours[-1]
    return f"{'/'.join(parts[-2:])}:{found['line']}, {found['function']}"
