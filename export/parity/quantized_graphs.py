"""The quantized graphs of a bundle, for the parity check: their dequantized forms, and what is wrong with them."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import onnx

from ...runtime.bundle.manifest import GraphName, Manifest, Precision, graph_file_name
from ..quantization.blocks import OPERATORS, WEIGHTED, blocks_of
from .activation_scales import DequantizedSession
from .dequantized_graph import DequantizedGraph, dequantize, is_quantized


@dataclass(frozen=True)
class QuantizedGraphs:
    """The quantized graphs of a bundle, by name; empty for a float32 bundle.

    forms: their dequantized forms with the operators of the file, for the comparison of weights and operators.
    sessions: run the dequantized forms.
    """

    forms: Mapping[str, DequantizedGraph]
    sessions: Mapping[str, DequantizedSession]

    @classmethod
    def read(cls, bundle: Path, manifest: Manifest) -> "QuantizedGraphs":
        """Read the graphs of a bundle."""
        forms: dict[str, DequantizedGraph] = {}
        sessions: dict[str, DequantizedSession] = {}
        for name in manifest.graphs:
            model = onnx.load_model(bundle / graph_file_name(name))
            if is_quantized(model.graph):
                forms[name] = dequantize(model, with_relu=False)
                sessions[name] = DequantizedSession(dequantize(model))
        return cls(forms, sessions)

    @property
    def precision(self) -> Precision:
        """The precision of the bundle, by its graph files."""
        return "int8" if self.forms else "float32"

    def failures(self, manifest: Manifest) -> list[str]:
        """Contradictions between the scales of a graph, and blocks that the manifest does not record."""
        lines = [f"{name}.{line}" for name, form in self.forms.items() for line in form.failures]
        record = manifest.quantization
        found = sorted(block for name, form in self.forms.items() for block in _quantized_blocks(name, form))
        if record is not None and sorted(record.quantized_blocks) != found:
            wrong = sorted(set(record.quantized_blocks) ^ set(found))
            lines.append(
                f"manifest.json: field quantization.quantized_blocks: expected the blocks that are int8 in the graphs; "
                f"got others: {', '.join(wrong[:3])}"
            )
        return lines


def _quantized_blocks(name: str, form: DequantizedGraph) -> list[str]:
    """The blocks with a rounded weight."""
    rounded = {
        node.name for node in form.model.graph.node if node.op_type in WEIGHTED and node.input[1] in form.half_steps
    }
    return [
        block
        for block, nodes in blocks_of(form.model.graph, OPERATORS.get(cast("GraphName", name), ())).items()
        if rounded.intersection(nodes)
    ]
