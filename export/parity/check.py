"""The parity check of a bundle: compare everything in it with the PyTorch model in eager mode."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import torch

from ...model import DuoSpaceNet, DuoSpaceNetConfig
from ...runtime import Frame, Pipeline
from ...runtime.bundle.manifest import WeightsRecord, graph_file_name
from ...runtime.bundle.operators import DEFAULT_OPSET
from ...runtime.errors import ArtifactError
from ...runtime.progress import Progress, no_progress
from ...weights.input_contract import temporal_window
from ..graphs import Graph, graphs_to_export
from ..manifest_builder import graph_spec
from ..operator_forms import OperatorForms
from .comparison import Comparison
from .graph_constants import all_nodes, opset_of, read_graph, read_model
from .manifest_differences import manifest_differences
from .parity_result import ParityResult
from .quantized_graphs import QuantizedGraphs
from .reference import EagerReference
from .retraced_graphs import retrace_graphs
from .sequence_coverage import Coverage
from .stress_sequence import stress_sequence
from .weight_match import match_weights

RANDOM_INPUTS = 12  # of a graph


@torch.no_grad()
def check_parity(
    bundle: str | Path,
    model: DuoSpaceNet,
    frames: Sequence[Frame] = (),
    source: str = "your frames",
    random_inputs: int = RANDOM_INPUTS,
    weights: WeightsRecord | None = None,
    progress: Progress = no_progress,
    stress_frames: Sequence[Frame] | None = None,
    retrace: bool = False,
    engine: str = "onnxruntime",
) -> ParityResult:
    """Compare `bundle` with `model` in eager mode.

    No part of the reference is read from the bundle. The check has these parts:
    - The manifest is compared with that of the model's configuration and weights.
    - The weights in the graph files are compared with the model's.
    - The pipeline runs as a stream over the stress sequence. Each graph also runs on eager mode's inputs.
    - Each graph runs on random inputs over its whole legal domain.
    - Each element of each input is disturbed.
    - With `retrace`, the graphs are compared with a new export of the model.
    - Of quantized graphs, the dequantized form is compared, and the scales of their activations.

    frames: consecutive frames of the user, which are compared after the stress sequence. source: their name.
    random_inputs: number of random inputs.
    weights: provenance of the model's weights. By default the manifest's record is compared with their hash only.
    stress_frames: frames in place of the stress sequence; the result fails if they do not cover as much.
    retrace: export the model again and compare its graphs. Not needed right after an export.
    engine: the library that runs the graphs, "onnxruntime" or "openvino".

    Raises ArtifactError if the bundle is damaged or its graphs have other inputs or outputs than the model's. Raises
    InputError if a frame is invalid.
    """
    pipeline, reference = Pipeline.load(bundle, require_parity=False, engine=engine), EagerReference(model)
    graphs = graphs_to_export(model)
    _check_same_tensors(Path(bundle), pipeline, graphs)
    config = model.config
    stress_frames = stress_sequence(config) if stress_frames is None else stress_frames
    quantized = QuantizedGraphs.read(Path(bundle), pipeline.manifest)
    comparison = Comparison(pipeline, reference, quantized.sessions)
    windows = comparison.add_sequence(stress_frames, 0, progress, "stress sequence")
    if frames:
        comparison.add_sequence(frames, len(stress_frames), progress, source)
    counts = comparison.add_random_inputs(random_inputs, progress)
    files: dict[str, Path] = {name: Path(bundle) / graph_file_name(name) for name in reference.graphs}
    coverage = Coverage.of(stress_frames, windows, config, temporal_window(config))
    return ParityResult(
        source=f"stress sequence and {source}" if frames else "stress sequence",
        frames=len(stress_frames) + len(frames),
        graphs=comparison.graph_errors,
        stream=comparison.stream_errors,
        coverage=coverage,
        shortfalls=coverage.shortfalls(config),
        random_inputs=counts,
        scales=comparison.scales,
        liveness=comparison.check_liveness(random_inputs, progress),
        manifest=manifest_differences(
            pipeline.manifest, model, graphs, _operator_forms(files, config), weights, quantized.precision
        ),
        weights=match_weights(files, graphs, quantized.forms),
        retrace=retrace_graphs(Path(bundle), pipeline.manifest, graphs, progress, quantized.forms) if retrace else None,
        precision=quantized.precision,
        quantization=(*quantized.failures(pipeline.manifest), *comparison.scale_failures()),
    )


def _operator_forms(files: Mapping[str, Path], config: DuoSpaceNetConfig) -> OperatorForms:
    """The forms of the operators in the graph files. All files must have the version of the backbone."""
    is_native = not config.is_deformable or _has_operator(files["backbone"], "DeformConv")
    # Only the compact form lists visible locations. A model has a lifter, attends to PV, or both.
    is_compact = any(_has_operator(files[name], "NonZero") for name in ("lifter", "decoder") if name in files)
    return OperatorForms(
        dcn="native" if is_native else "grid-sample",
        attention="compact" if is_compact else "grid-sample",
        opset=opset_of(read_model(files["backbone"])),
    )


def _has_operator(file: Path, operator: str) -> bool:
    return any(node.op_type == operator for node in all_nodes(read_graph(file)))


def _check_same_tensors(bundle: Path, pipeline: Pipeline, graphs: Sequence[Graph]) -> None:
    """Raise ArtifactError if the bundle has other graphs, inputs or outputs than the model."""
    names = [graph.name for graph in graphs]
    if set(names) != pipeline.sessions.keys():
        raise ArtifactError(
            f"{bundle}: expected the model's graphs {', '.join(names)}; got "
            f"{', '.join(pipeline.sessions)}. Use the checkpoint that the bundle was exported from."
        )
    for graph in graphs:
        actual = pipeline.manifest.graphs[graph.name]
        expected = graph_spec(graph, actual.sha256, DEFAULT_OPSET)  # only its tensors are compared
        if (expected.inputs, expected.outputs) != (actual.inputs, actual.outputs):
            raise ArtifactError(
                f"{bundle / actual.file}: expected the inputs and outputs of the model's {graph.name} graph; got "
                "others. Use the checkpoint that the bundle was exported from."
            )
