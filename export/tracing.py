"""Trace a torch module and write it as one ONNX file. This is the only call of `torch.onnx.export`."""

import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import onnx
import onnx_ir
import onnxscript.optimizer
import torch
from onnx_ir.passes.common import ClearMetadataAndDocStringPass

from ..runtime.files import path_for_native_code
from .graphs import Graph
from .operator_forms import TRANSLATIONS, OperatorForms


def trace(graph: Graph, path: Path, forms: OperatorForms | None = None) -> torch.export.ExportedProgram:
    """Trace `graph` and write it to `path` as one file.

    The file holds only standard operators of `forms.opset`, no external data, and no source paths.

    forms: version of the operators, and forms of those that have two.

    Returns the program that was converted to ONNX. The tensors in the file are named after its nodes.
    """
    with _quiet_exporter():
        forms = forms or OperatorForms()
        program = torch.export.export(graph.module, tuple(_example(spec) for spec in graph.inputs.values()))
        return write_onnx(forms.apply(program), graph, path, forms.opset)


def write_onnx(
    program: torch.export.ExportedProgram, graph: Graph, path: Path, opset: int
) -> torch.export.ExportedProgram:
    """Convert the program of `graph` to ONNX, optimise it, write it to `path` and check the file.

    opset: version of ONNX's operator set. The translations of this package give operators of `DEFAULT_OPSET`, and the
    exporter converts them to later versions.

    Returns the program after the exporter's own decompositions, in the operators that were converted.
    """
    converted = torch.onnx.export(
        program,
        input_names=list(graph.inputs),
        output_names=list(graph.outputs),
        opset_version=opset,
        custom_translation_table=TRANSLATIONS,
        dynamo=True,
        optimize=False,
        external_data=False,
        verbose=False,
    )
    assert converted is not None and converted.exported_program is not None, "dynamo=True returns a program"
    model = converted.model
    # With optimize=True the exporter applies its rewrite rules twice. Once takes half the time and gives the same
    # operators.
    onnxscript.optimizer.optimize(model, num_iterations=1)
    # The exporter stores stack traces with absolute source paths in the nodes.
    ClearMetadataAndDocStringPass()(model)
    model.graph.name = graph.name
    model.producer_name, model.producer_version = "duospacenet", None
    onnx_ir.save(model, path)
    with path_for_native_code(path) as name:
        onnx.checker.check_model(name, full_check=True)
    return converted.exported_program


def _example(spec: torch.Tensor) -> torch.Tensor:
    """An uninitialised tensor for the tracer, which reads only its shape and type."""
    return torch.empty(spec.shape, dtype=spec.dtype)


@contextmanager
def _quiet_exporter() -> Iterator[None]:
    """Silence the exporter's log messages and all warnings. Its errors are exceptions and are not affected."""
    loggers = [logging.getLogger(name) for name in ("torch.onnx", "onnxscript", "onnx_ir")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)
