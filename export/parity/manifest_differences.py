"""Compare the manifest of a bundle with the manifest that the model's configuration would give today."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from ...model import DuoSpaceNet
from ...runtime.bundle.manifest import Manifest, Precision, WeightsRecord
from ...runtime.printable import printable, shortened
from ...weights.provenance import hash_weights
from ..graphs import Graph
from ..manifest_builder import build_manifest
from ..operator_forms import OperatorForms

# Not part of the contract, or checked elsewhere: the runtime checks the seal, the hashes and the operator sets.
_EXCLUDED = {"versions", "parity", "sha256", "schema_version", "weights", "quantization", "golden"}


class _Absent:
    """The value of a field that one side does not have."""

    def __repr__(self) -> str:
        return "nothing"


_ABSENT = _Absent()


@dataclass(frozen=True)
class FieldDifference:
    """A field of the manifest with a wrong value. field: its path, such as `window.largest_speed_m_s`."""

    field: str
    expected: str
    actual: str

    def __str__(self) -> str:
        return f"manifest.json: field {self.field}: expected {self.expected}; got {self.actual}"


def manifest_differences(
    manifest: Manifest,
    model: DuoSpaceNet,
    graphs: list[Graph],
    forms: OperatorForms,
    weights: WeightsRecord | None = None,
    precision: Precision = "float32",
) -> list[FieldDifference]:
    """The fields that differ from those of the model's configuration and weights.

    Every field of the contract is compared, also the texts for readers. The versions of packages may differ.

    graphs: the model's graphs, from `graphs_to_export`.
    forms: forms of the operators in the bundle's graphs; all are legal.
    weights: provenance of the model's weights. If it is given, "trained" is compared too, unless the manifest says
        that it is unknown, as after an export of a model in memory.
    precision: of the bundle's graphs. The quantization record of an int8 bundle is not compared.
    """
    hashes = {name: graph.sha256 for name, graph in manifest.graphs.items()}
    expected = build_manifest(model.config, manifest.weights, graphs, hashes, forms).model_copy(
        update={"precision": precision}
    )
    sides = (side.model_dump(mode="json", exclude=_EXCLUDED) for side in (expected, manifest))
    differences = list(_differences("", *sides))
    expected_weights: dict[str, Any] = {"sha256": hash_weights(model)}
    if weights and manifest.weights.trained is not None:
        expected_weights["trained"] = weights.trained
    actual_weights = {name: getattr(manifest.weights, name) for name in expected_weights}
    return differences + list(_differences("weights", expected_weights, actual_weights))


def _differences(field: str, expected: Any, actual: Any) -> Iterator[FieldDifference]:
    """Yield every leaf that differs."""
    if isinstance(expected, dict) and isinstance(actual, dict):
        for key in {**expected, **actual}:
            path = f"{field}.{printable(key)}" if field else key
            yield from _differences(path, expected.get(key, _ABSENT), actual.get(key, _ABSENT))
    elif expected != actual:
        yield FieldDifference(field, shortened(expected, 200), shortened(actual, 200))
