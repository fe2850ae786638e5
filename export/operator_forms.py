"""The ONNX operators of a bundle: their version, and the form of those that have two.

Of the two forms, one is for onnxruntime and one for other engines.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import torch

from ..model.backbones.deformable_convolution import sample_and_multiply
from ..model.deformable_sampling import sample_and_sum
from ..runtime.bundle.manifest import AttentionForm, DeformableForm, Manifest
from ..runtime.bundle.operators import DEFAULT_OPSET
from . import deformable, sampling_forms

# By torch operator, its formula in plain torch operators: the form "grid-sample".
FORMULAS: dict[torch._ops.OpOverload, Callable[..., Any]] = {
    deformable.OPERATOR: sample_and_multiply,
    sampling_forms.OPERATOR: sample_and_sum,
}
# By torch operator, its translation to the form for onnxruntime, for the exporter.
TRANSLATIONS: dict[Callable[..., Any], Callable[..., Any]] = {
    deformable.OPERATOR: deformable.to_deform_conv,
    sampling_forms.OPERATOR: sampling_forms.to_compact,
}


_OPSET_OF_SCHEMA_1 = 20  # whose manifests do not record it


class OperatorForms(NamedTuple):
    """The form of each operator. All forms and all versions compute the same.

    dcn: of the deformable convolutions in the backbone.
    attention: of PV attention and of lifting.
    opset: version of ONNX's operator set, one of `OPSETS`.
    """

    dcn: DeformableForm = "native"
    attention: AttentionForm = "compact"
    opset: int = DEFAULT_OPSET

    @classmethod
    def of(cls, manifest: Manifest) -> "OperatorForms":
        """The forms of a bundle. All of its graphs have the same version."""
        opsets = next(iter(manifest.graphs.values())).opsets
        return cls(manifest.dcn or "native", manifest.attention, opsets.get("", _OPSET_OF_SCHEMA_1))

    def apply(self, program: torch.export.ExportedProgram) -> torch.export.ExportedProgram:
        """Replace the operators of the form "grid-sample" by their formulas in plain torch operators."""
        forms = {deformable.OPERATOR: self.dcn, sampling_forms.OPERATOR: self.attention}
        targets = {node.target for node in program.graph.nodes}
        replaced = {op: FORMULAS[op] for op, form in forms.items() if form == "grid-sample" and op in targets}
        return program.run_decompositions(replaced) if replaced else program
