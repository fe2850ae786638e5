"""From a torch module to one portable ONNX file: the only call to `torch.onnx.export` in the repository."""

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

from ..runtime.bundle.manifest import DeformableForm
from ..runtime.files import path_for_native_code
from . import deformable
from .graphs import Graph

OPSET = 20


def trace(graph: Graph, path: Path, dcn: DeformableForm = "native") -> torch.export.ExportedProgram:
    """Trace `graph` and write it to `path`: one file, standard operators of `OPSET`, no source paths in it.

    dcn: the form of deformable convolutions. Returns the traced program: the tensors in the file are named after its
    nodes.
    """
    with _quiet_exporter():
        traced = torch.export.export(graph.module, tuple(_example(spec) for spec in graph.inputs.values()))
        program = torch.onnx.export(
            traced if dcn == "native" else deformable.decompose(traced),
            input_names=list(graph.inputs),
            output_names=list(graph.outputs),
            opset_version=OPSET,
            custom_translation_table={deformable.OPERATOR: deformable.native},
            dynamo=True,
            optimize=False,
            external_data=False,
            verbose=False,
        )
        assert program is not None and program.exported_program is not None, "dynamo=True returns a program"
        model = program.model
        # The exporter goes over its rewrite rules twice; once takes half the time and leaves the same operators.
        onnxscript.optimizer.optimize(model, num_iterations=1)
    ClearMetadataAndDocStringPass()(model)
    model.graph.name = graph.name
    model.producer_name, model.producer_version = "duospacenet", None
    onnx_ir.save(model, path)
    with path_for_native_code(path) as name:
        onnx.checker.check_model(name, full_check=True)
    return program.exported_program


def _example(spec: torch.Tensor) -> torch.Tensor:
    """What a trace takes for an example: never read, for a trace computes nothing, and so it takes no memory."""
    return torch.empty(spec.shape, dtype=spec.dtype)


@contextmanager
def _quiet_exporter() -> Iterator[None]:
    """The exporter logs its steps, and warns of its own deprecations; errors come as exceptions all the same."""
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
