"""Liveness by element: disturb parts of a graph's inputs, and compare the bundle's outputs with eager mode's.

Many elements are disturbed in one run. If the outputs differ, the run is split until the wrong elements are known.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor

from ..graphs import Graph
from .input_elements import Element, elements_of

IsEqual = Callable[[Mapping[str, Tensor]], bool]  # whether bundle and eager mode agree on these inputs of a graph

_MAX_LOCATED = 4  # wrong elements that are located per graph; each takes several runs
# Fewer runs for the graphs that take long and have few kinds of elements.
_RUNS = {"backbone": 2, "lifter": 3, "segmenter": 1}
_DEFAULT_RUNS = 8


@dataclass
class Liveness:
    """The result for one graph. elements: number of elements that were disturbed. wrong: those that failed."""

    elements: int
    wrong: list[str] = field(default_factory=list)


def check_liveness(graph: Graph, inputs: Mapping[str, Tensor], is_equal: IsEqual, one_by_one: bool = False) -> Liveness:
    """Disturb every element of the inputs once.

    inputs: typical inputs with every slot and camera valid, on which bundle and eager mode agree. Otherwise a masked
        element would have no effect.
    one_by_one: disturb every element in a separate run.
    """
    elements = elements_of(graph)
    result = Liveness(len(elements))
    num_groups = max(_RUNS.get(graph.name, _DEFAULT_RUNS), _num_slots(graph) + 1)
    for group in [[each] for each in elements] if one_by_one else group_elements(elements, num_groups):
        for wrong in _locate(group, inputs, is_equal, _MAX_LOCATED - len(result.wrong)):
            result.wrong.append(f"{graph.name}.{wrong}")
    return result


def group_elements(elements: Sequence[Element], num_groups: int) -> list[list[Element]]:
    """Divide the elements into groups that can be disturbed together: none is masked by a flag of its group.

    num_groups: at least the number of slots plus 1.
    """
    generator = torch.Generator().manual_seed(0)
    groups: list[list[Element]] = [[] for _ in range(num_groups)]
    # The flag of a slot masks the most elements, so these flags come first, each in its own group. The flags of cameras
    # come next.
    order = {"frame_valid": 0, "camera_valid": 1}
    for element in sorted(elements, key=lambda element: order.get(element.name, 2)):
        if element.name == "frame_valid" and element.slot is not None:
            groups[element.slot - 1].append(element)
            continue
        free = [group for group in groups if not any(other.masks(element) for other in group if other.name in order)]
        free[int(torch.randint(len(free), (), generator=generator))].append(element)
    return [group for group in groups if group]


def _num_slots(graph: Graph) -> int:
    return len(graph.inputs["frame_valid"]) if "frame_valid" in graph.inputs else 0


def _locate(group: Sequence[Element], inputs: Mapping[str, Tensor], is_equal: IsEqual, limit: int) -> list[str]:
    """The elements of `group` on which bundle and eager mode differ, at most `limit`."""
    if limit <= 0 or is_equal(_disturbed(inputs, group)):
        return []
    if len(group) == 1:
        return [str(group[0])]
    half = len(group) // 2
    located = _locate(group[:half], inputs, is_equal, limit)
    located += _locate(group[half:], inputs, is_equal, limit - len(located))
    # Together the elements fail, although each half passes.
    return located or [f"{group[0]} together with {len(group) - 1} other elements"]


def _disturbed(inputs: Mapping[str, Tensor], group: Sequence[Element]) -> dict[str, Tensor]:
    """A copy of the inputs in which every element of `group` is disturbed."""
    changed = dict(inputs)
    generator = torch.Generator().manual_seed(0)
    for name in {element.name for element in group}:
        changed[name] = inputs[name].clone()
    for element in group:
        element.disturb(changed[element.name], generator)
    return changed
