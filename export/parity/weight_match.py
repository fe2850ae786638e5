"""The weights of a bundle, compared by value with the weights of the model.

A test on inputs finds a changed weight only if the change is large enough to move an output beyond the tolerance. This
check finds it by itself: every floating-point constant of a graph must hold the numbers of a tensor of the model.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..graphs import Graph
from .attribute_match import AttributeDifference, attribute_differences
from .dequantized_graph import DequantizedGraph
from .graph_constants import GraphConstant, floating_point_constants, read_model
from .stored_form import StoredForm, stored_forms
from .used_tensors import used_tensors

LINES = 10
FEW = 16  # the exporter's own constants have fewer different numbers, such as the size of a level


@dataclass(frozen=True)
class WeightDifference:
    """A constant of a graph that differs from the tensor of the model that it should hold.

    graph, constant: the name of the graph, and of the constant in its file.
    tensor: the name of the model's tensor. A folded constant depends on more tensors; this is the first.
    index: the place of the largest difference, in the shape of the constant.
    value: the number in the graph. expected: the number that the model gives.
    numbers: how many numbers differ.
    reordered: whether the constant holds the numbers of the tensor in another order.
    """

    graph: str
    constant: str
    tensor: str
    index: tuple[int, ...]
    value: float
    expected: float
    numbers: int
    reordered: bool


@dataclass(frozen=True)
class WeightMatch:
    """The tensors of a model that its graphs hold.

    parameters: how many tensors of the model, parameters and buffers, the outputs of the graphs depend on.
    matched: how many of them were found in the right graph by their values.
    values, matched_values: the same in single numbers.
    not_found: names of the tensors that were not found. A graph may hold them in a form that is not recognised.
    differing: constants that hold almost the numbers of a tensor. Each is a failure.
    unexplained: larger constants, as `graph.constant`, that hold nothing of the model. Each is a failure: an export
        has none.
    attributes: attributes of operators that differ from the model's modules. Each is a failure.
    """

    parameters: int
    matched: int
    values: int
    matched_values: int
    not_found: tuple[str, ...]
    differing: tuple[WeightDifference, ...]
    unexplained: tuple[str, ...]
    attributes: tuple[AttributeDifference, ...]

    @property
    def failures(self) -> list[str]:
        """One line per failure, at most `LINES` of each kind: the bundle of another checkpoint differs everywhere."""
        return [
            *_shortened([_describe(difference) for difference in self.differing], "constants differ"),
            *_shortened(
                [f"{name}: expected a tensor of the model; got other numbers" for name in self.unexplained],
                "constants hold no tensor of the model",
            ),
            *_shortened([str(difference) for difference in self.attributes], "attributes differ"),
        ]


def match_weights(
    graph_files: Mapping[str, Path] | Mapping[str, bytes],
    graphs: Sequence[Graph],
    quantized: Mapping[str, DequantizedGraph] | None = None,
) -> WeightMatch:
    """Find the tensors of a model in the graphs of a bundle, and the constants that differ from them.

    graph_files: the path or the content of each graph's file, by the name of the graph.
    graphs: those of the model, from `graphs_to_export`. They hold the model's tensors as its rewrites make them.
    quantized: the dequantized form of each quantized graph. Its weights may differ by half a step.
    """
    forms = quantized or {}
    matches = [_match_graph(graph, graph_files[graph.name], forms.get(graph.name)) for graph in graphs]
    sizes = {name: size for match in matches for name, size in match.sizes.items()}
    found = {name for match in matches for name in match.found}
    return WeightMatch(
        parameters=len(sizes),
        matched=len(found),
        values=sum(sizes.values()),
        matched_values=sum(sizes[name] for name in found),
        not_found=tuple(name for name in sizes if name not in found),
        differing=tuple(difference for match in matches for difference in match.differing),
        unexplained=tuple(name for match in matches for name in match.unexplained),
        attributes=tuple(difference for match in matches for difference in match.attributes),
    )


@dataclass(frozen=True)
class _GraphMatch:
    """The part of a `WeightMatch` for one graph. sizes: how many numbers each tensor has that the graph uses."""

    sizes: dict[str, int]
    found: set[str]
    differing: list[WeightDifference]
    unexplained: list[str]
    attributes: list[AttributeDifference]


def _match_graph(graph: Graph, file: Path | bytes, quantized: DequantizedGraph | None) -> _GraphMatch:
    used, stored = used_tensors(graph), quantized.model if quantized else read_model(file)
    forms, constants = stored_forms(used), list(floating_point_constants(stored.graph))
    if quantized:
        constants = [each._replace(error=quantized.half_steps.get(each.name, 0.0)) for each in constants]
    equal = {constant.name: form for constant in constants if (form := _equal_form(constant, forms))}
    found = {name for form in equal.values() for name in form.tensors}
    found |= _found_twice(forms, constants, found)
    others = [constant for constant in constants if constant.name not in equal]
    differing = _differing_constants(others, forms, found)
    tensor_of = {name: form.tensors[0] for name, form in (equal | differing).items()}
    return _GraphMatch(
        sizes={name: tensor.numel() for name, tensor in used.tensors.items()},
        found=found,
        differing=[_difference(graph.name, c, differing[c.name]) for c in others if c.name in differing],
        unexplained=[
            f"{graph.name}.{c.name}" for c in others if c.name not in differing and not _is_of_the_exporter(c)
        ],
        attributes=list(attribute_differences(graph.name, stored, tensor_of, graph.model)),
    )


def _equal_form(constant: GraphConstant, forms: Sequence[StoredForm]) -> StoredForm | None:
    """The form whose numbers the constant holds."""
    return next((form for form in _candidates(constant, forms) if form.equals(constant.values, constant.error)), None)


def _found_twice(forms: Sequence[StoredForm], constants: Sequence[GraphConstant], found: set[str]) -> set[str]:
    """The tensors that have not been found because they equal one that has been: a graph holds such numbers once."""
    missing = [form for form in forms if not found.issuperset(form.tensors)]
    return {
        name
        for form in missing
        if any(
            constant.values.size == form.size and form.equals(constant.values, constant.error) for constant in constants
        )
        for name in form.tensors
    }


def _differing_constants(
    constants: Sequence[GraphConstant], forms: Sequence[StoredForm], found: set[str]
) -> dict[str, StoredForm]:
    """The form that each constant should hold, by the name of the constant, if there is a sign of any.

    constants: those that hold no tensor of the model.
    found: the tensors of the model that others hold.
    """
    differing = {constant.name: form for constant in constants if (form := _similar_form(constant, forms))}
    # The last sign is that a tensor of this size is missing. Zeros come last, because the exporter has such constants.
    held = found.union(*(form.tensors for form in differing.values()))
    for constant in sorted(constants, key=_is_of_the_exporter):
        missing = (form for form in _candidates(constant, forms) if not held.issuperset(form.tensors))
        if constant.name not in differing and (form := next(missing, None)):
            differing[constant.name] = form
            held |= set(form.tensors)
    return differing


def _similar_form(constant: GraphConstant, forms: Sequence[StoredForm]) -> StoredForm | None:
    """The form with the constant's name, or with half of its numbers, or with the same numbers in another order."""
    candidates = _candidates(constant, forms)
    named = [form for form in candidates if form.usual_name == _usual_name(constant)]
    nearest = max(named or candidates, key=lambda form: _agreement(form, constant), default=None)
    if nearest and (named or _agreement(nearest, constant) >= 0.5):
        return nearest
    return next((form for form in candidates if _is_reordered(constant, form)), None)


def _candidates(constant: GraphConstant, forms: Sequence[StoredForm]) -> list[StoredForm]:
    """The forms with as many numbers as the constant. Those with its name come first, because they are likely."""
    same_size = [form for form in forms if form.size == constant.values.size]
    return sorted(same_size, key=lambda form: form.usual_name != _usual_name(constant))


def _is_of_the_exporter(constant: GraphConstant) -> bool:
    """Whether the constant can be one of the exporter's own: a few different numbers, or positions of pixels."""
    values = constant.values
    return np.unique(values).size <= FEW or bool(np.isfinite(values).all() and (values == np.round(values)).all())


def _usual_name(constant: GraphConstant) -> str:
    return constant.name.removeprefix("model.")


def _agreement(form: StoredForm, constant: GraphConstant) -> float:
    """The fraction of equal numbers."""
    return float(np.mean(form.differences(constant.values, constant.error) == 0))


def _is_reordered(constant: GraphConstant, form: StoredForm) -> bool:
    values, error = form.compute()
    tolerance = 0.0 if isinstance(error, float) else float(error.max())
    return np.allclose(np.sort(constant.values, axis=None), np.sort(values, axis=None), rtol=0, atol=tolerance)


def _difference(graph: str, constant: GraphConstant, form: StoredForm) -> WeightDifference:
    differences = form.differences(constant.values, constant.error)
    place = int(differences.argmax())
    return WeightDifference(
        graph=graph,
        constant=constant.name,
        tensor=form.tensors[0],
        index=tuple(int(i) for i in np.unravel_index(place, constant.values.shape)),
        value=float(constant.values.ravel()[place]),
        expected=float(np.ravel(form.compute()[0])[place]),
        numbers=int(np.count_nonzero(differences)),
        reordered=_is_reordered(constant, form),
    )


def _describe(difference: WeightDifference) -> str:
    found = "its numbers in another order" if difference.reordered else f"{difference.numbers} other numbers"
    return (
        f"{difference.graph}.{difference.constant}: expected the model's {difference.tensor}; got {found}, "
        f"{difference.value:.9g} instead of {difference.expected:.9g} at {list(difference.index)}"
    )


def _shortened(lines: list[str], summary: str) -> list[str]:
    """The first lines, and how many there are in all."""
    return lines if len(lines) <= LINES else [*lines[:LINES], f"{len(lines)} {summary}; the first {LINES} are listed"]
