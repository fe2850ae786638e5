"""The bisection: search a failing bundle for the first wrong graph, tensor, or input of the stream."""

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, cast

import onnx
import torch
from numpy.typing import NDArray

from ...model import DuoSpaceNet
from ...runtime import Frame, Pipeline
from ...runtime.bundle.manifest import GraphName, graph_file_name
from ...runtime.parity.tensor_error import TensorError
from ...runtime.parity.tolerances import GRAPH_TOLERANCE
from ...runtime.progress import Progress, no_progress
from ...runtime.recording_session import RecordingSession, recording_pipeline
from ...runtime.session import to_tensors
from ...weights.input_contract import temporal_window
from ..graphs import Graph, graphs_to_export
from ..operator_forms import OperatorForms
from ..parity.check import check_parity
from ..parity.comparison import arrays
from ..parity.expected_windows import expected_windows, is_skipped
from ..parity.parity_result import ParityResult
from ..parity.random_inputs import RandomInputs
from ..parity.reference import EagerReference, GraphRun
from ..parity.stress_sequence import stress_sequence
from ..tracing import trace
from .bisection_result import Bisection, Kind
from .camera_parts import without_lost_cameras, worst_group
from .deviation import Deviation, deviations, intermediate_error
from .differences import differences
from .input_differences import INPUT_TOLERANCE, input_differences
from .intermediates import Intermediates
from .pieces import CutGraph, unoptimised_session


class Trace(NamedTuple):
    """A fresh export of one graph: the traced program and the ONNX model made from it."""

    program: torch.export.ExportedProgram
    file: onnx.ModelProto


def bisect_parity(
    bundle: str | Path,
    model: DuoSpaceNet,
    frames: Sequence[Frame] = (),
    result: ParityResult | None = None,
    progress: Progress = no_progress,
    traces: Mapping[str, Trace] | None = None,
    stress_frames: Sequence[Frame] | None = None,
) -> Bisection:
    """Find the first place where `bundle` differs from `model`.

    frames, stress_frames: as for `check_parity`.
    result: the result of `check_parity` on these frames. By default the check runs here.
    traces: fresh exports of this model's graphs, by graph name. A graph that is not among them is exported when needed.

    Raises the errors of `check_parity`.
    """
    pipeline = Pipeline.load(bundle, require_parity=False)
    stress_frames = stress_sequence(model.config) if stress_frames is None else stress_frames
    result = result or check_parity(bundle, model, frames, progress=progress, stress_frames=stress_frames)
    search = _Search(Path(bundle), pipeline, EagerReference(model), (stress_frames, frames), result, traces or {})
    if result.failing_outputs:
        return search.search_graph(*result.failing_outputs[0])
    if result.wrong_elements:
        return search.find_reader(result.wrong_elements[0])
    if result.failing_frames:
        return search.search_stream()
    if result.weights and result.weights.failures:
        return Bisection("constant", remarks=tuple(result.weights.failures))
    if result.retrace and result.retrace.differences:
        return Bisection("operator", remarks=result.retrace.differences)
    if result.manifest:
        return Bisection("manifest", remarks=tuple(map(str, result.manifest)))
    return Bisection("none")


def trace_graph(graph: Graph, forms: OperatorForms | None = None) -> Trace:
    """Export a graph to a temporary folder.

    graph: from `graphs_to_export`. forms: of the operators, by default those of an export.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / graph_file_name(graph.name)
        return Trace(trace(graph, path, forms), onnx.load(path))


@dataclass(frozen=True)
class _Search:
    """The search in one bundle.

    sequences: the stress sequence and the user's frames.
    result: the failing result of the bundle's parity check.
    """

    bundle: Path
    pipeline: Pipeline
    reference: EagerReference
    sequences: tuple[Sequence[Frame], Sequence[Frame]]
    result: ParityResult
    traces: Mapping[str, Trace]

    def search_graph(self, name: str, output: str, failing: TensorError) -> Bisection:
        """Search the graph `name`. Its output `output` has the error `failing` on eager mode's inputs."""
        run, eager, file, fresh = self._reference_run(name, failing), *self._open(name)
        if name == "backbone":
            run = worst_group(run, self._outputs(name, run), self._cameras_per_run)
        frame, case = failing.frame, {"frame": failing.frame, "seed": failing.seed}
        # If the traced program is already wrong, every piece of the file can still equal it.
        expected = arrays(run.outputs)
        traced_output, traced_error = _worst_output(eager.values(run.outputs, run.inputs), expected, frame)
        if not traced_error.relative <= GRAPH_TOLERANCE:
            return self._result("trace", name, **case, tensor=traced_output, error=traced_error)
        compared = deviations(file, eager, run.inputs, frame)
        # `not <=` instead of `>`, here and below, so that a NaN counts as wrong.
        wrong = [deviation for deviation in compared if not deviation.error.relative <= GRAPH_TOLERANCE]
        counts = {"num_off": len(wrong), "num_compared": len(compared)}
        if wrong:
            return self._result("tensor", name, **case, **_describe(wrong[0], eager, file, fresh), **counts)
        unoptimised = _run_unoptimised(self.bundle / graph_file_name(name), run)
        if _worst_output(unoptimised, expected, frame)[1].relative <= GRAPH_TOLERANCE:
            return self._result("optimiser", name, **case, tensor=output, error=failing, **counts)
        # A few huge numbers raise the RMS of a tensor and can hide a wrong element: for example the pixel coordinates
        # of points behind a camera. A comparison with a fresh export does not depend on the RMS.
        changed = next((deviation for deviation in compared if differences(file, fresh, deviation.piece.tensor)), None)
        if changed:
            return self._result("tensor", name, **case, **_describe(changed, eager, file, fresh), **counts)
        worst = max(compared, key=lambda deviation: deviation.error.relative)
        return self._result("rounding", name, **case, **_describe(worst, eager, file, fresh), **counts)

    def find_reader(self, wrong_element: str) -> Bisection:
        """Find the part of the model that should read `wrong_element`, which is given as `graph.input[place]`."""
        graph, element = wrong_element.split(".", 1)
        eager, file, fresh = self._open(graph)
        readers = [piece.tensor for piece in fresh.pieces.values() if element.split("[")[0] in piece.reads]
        remarks = tuple(line for reader in readers for line in differences(file, fresh, reader))
        origin = vars(eager.origin(readers[0])) if readers else {}
        return self._result("input", graph, tensor=element, remarks=remarks, **origin)

    def search_stream(self) -> Bisection:
        """Search the first failing frame of the stream. Each graph is right on eager mode's inputs."""
        frame = self.result.failing_frames[0]
        sequence, index = self._locate(frame)
        recordings = self._record_frame(sequence, index)
        if is_skipped(sequence[index]):
            return Bisection("stream output", frame=frame)
        runs = self._reference_runs(sequence, index)
        wrong_inputs = input_differences(recordings, runs, list(sequence[index].cameras), frame)
        if wrong_inputs:
            first, others = wrong_inputs[0], tuple(f"{other.graph}.{other.name}" for other in wrong_inputs[1:])
            remarks = (first.remark,) if first.remark else ()
            return Bisection(
                "stream input", first.graph, frame, first.name, error=first.error, remarks=remarks, others=others
            )
        # This equals eager mode's, because no input is wrong.
        camera_valid = recordings["backbone"].inputs["camera_valid"]
        for name, recording in recordings.items():
            if recording.outputs:
                outputs, expected = (
                    without_lost_cameras(values, camera_valid)
                    for values in (recording.outputs, arrays(runs[name].outputs))
                )
                output, error = _worst_output(outputs, expected, frame)
                if not error.relative <= INPUT_TOLERANCE:
                    return Bisection("stream output", name, frame, output, error=error)
        return Bisection("stream output", frame=frame)

    def _record_frame(self, sequence: Sequence[Frame], index: int) -> dict[str, RecordingSession]:
        """Run a new stream up to frame `index`, and record each graph's inputs and outputs for it.

        The recording of a graph that did not run for this frame is empty: for example the projector, which runs only
        when the calibration changes.
        """
        pipeline, recordings = recording_pipeline(self.pipeline)
        stream = pipeline.stream(maps="segmenter" in recordings)
        for frame in sequence[: index + 1]:
            for recording in recordings.values():
                recording.forget()
            stream.step(frame)
        return recordings

    def _reference_run(self, name: str, error: TensorError) -> GraphRun:
        """Eager mode's inputs and outputs of a graph, for the frame or the random inputs of an error."""
        if error.seed is None:
            assert error.frame is not None
            return self._reference_runs(*self._locate(error.frame))[name]
        graph = cast("GraphName", name)
        random_inputs = RandomInputs(self.reference.model, self.result.scales, error.seed)
        # The seed of the inputs whose elements are disturbed is outside this range.
        all_valid = error.seed not in range(self.result.random_inputs[name])
        inputs = random_inputs.sample(self.reference.graphs[graph], all_valid)
        return self.reference.run(graph, inputs)

    def _outputs(self, name: str, run: GraphRun) -> dict[str, NDArray]:
        """The outputs of the bundle's graph on the inputs of `run`."""
        inputs = to_tensors(**arrays(run.inputs))
        return {output: value.numpy() for output, value in self.pipeline.sessions[name].run(inputs).items()}

    @property
    def _cameras_per_run(self) -> int:
        return self.pipeline.manifest.graphs["backbone"].inputs[0].shape[0]

    def _locate(self, frame: int) -> tuple[Sequence[Frame], int]:
        """The sequence that holds a frame, and its index there."""
        stress_frames, frames = self.sequences
        return (stress_frames, frame) if frame < len(stress_frames) else (frames, frame - len(stress_frames))

    def _reference_runs(self, sequence: Sequence[Frame], index: int) -> dict[str, GraphRun]:
        """Eager mode's inputs and outputs of every graph for one frame, by graph.

        Only the frames of its window are computed, from the oldest to the newest.
        """
        windows = expected_windows(sequence, temporal_window(self.reference.config))
        for past in reversed(windows[index]):
            window = [other for other in windows[past] if other in windows[index]]
            runs = self.reference.step(sequence, window)
        return runs

    def _open(self, name: str) -> tuple[Intermediates, CutGraph, CutGraph]:
        """Three forms of the graph `name`: in eager mode, in the bundle's file, and in a fresh export."""
        graph = next(graph for graph in graphs_to_export(self.reference.model) if graph.name == name)
        traced = self.traces.get(name) or trace_graph(graph, OperatorForms.of(self.pipeline.manifest))
        eager = Intermediates(traced.program, graph.outputs)
        file = onnx.load(self.bundle / graph_file_name(name))
        return eager, CutGraph(file, eager.names), CutGraph(traced.file, eager.names)

    def _result(self, kind: Kind, graph: str, **fields: Any) -> Bisection:
        """A bisection that ends in `graph`, with the failures in other graphs and inputs as `others`."""
        outputs = [f"{other}.{name}" for other, name, _ in self.result.failing_outputs if other != graph]
        elements = [name for name in self.result.wrong_elements if name != f"{graph}.{fields['tensor']}"]
        return Bisection(kind, graph, others=(*outputs, *elements), **fields)


def _describe(deviation: Deviation, eager: Intermediates, file: CutGraph, fresh: CutGraph) -> dict[str, Any]:
    """The fields of a `Bisection` that describe one tensor."""
    piece = deviation.piece
    return {
        "tensor": piece.tensor,
        "operators": piece.operators,
        "error": deviation.error,
        "reads": piece.reads,
        "remarks": tuple(differences(file, fresh, piece.tensor)),
        **vars(eager.origin(piece.tensor)),
    }


def _worst_output(
    actual: Mapping[str, NDArray], expected: Mapping[str, NDArray], frame: int | None
) -> tuple[str, TensorError]:
    """The output in `actual` with the largest error, and that error."""
    errors = {name: intermediate_error(name, value, expected[name], frame) for name, value in actual.items()}
    return max(errors.items(), key=lambda item: item[1].relative)


def _run_unoptimised(path: Path, run: GraphRun) -> dict[str, NDArray]:
    """The outputs of a graph file without onnxruntime's optimisations, on the inputs of `run`."""
    names, inputs = list(run.outputs), {name: value.numpy() for name, value in run.inputs.items()}
    return dict(zip(names, unoptimised_session(path).run(names, inputs), strict=True))
