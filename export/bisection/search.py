"""Where a bundle leaves the model: the first graph, and in it the first tensor; or what a stream was fed wrongly."""

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple, cast

import onnx
import torch
from numpy.typing import NDArray

from ...model import DuoSpaceNet
from ...runtime import Frame, Pipeline
from ...runtime.bundle.manifest import DeformableForm, GraphName
from ...runtime.progress import Progress, no_progress
from ..graphs import Graph
from ..manifest_builder import graph_file
from ..parity.check import GRAPH_TOLERANCE, ParityResult, check_parity, finite
from ..parity.comparison import TensorError
from ..parity.reference import EagerReference, Run
from ..parity.stress_sequence import stress_sequence, windows
from ..tracing import trace
from .deviation import Deviation, deviations, error_of
from .differences import differences
from .graph_inputs import FEED_TOLERANCE, input_differences, record
from .intermediates import Intermediates
from .pieces import CutGraph, plain_session

Kind = Literal["none", "tensor", "trace", "optimiser", "rounding", "dead input", "stream input", "stream output"]


class Trace(NamedTuple):
    """A graph of the model as it is exported now: the traced program, and the file that came of it."""

    program: torch.export.ExportedProgram
    file: onnx.ModelProto


@dataclass(frozen=True)
class Bisection:
    """The first place where a bundle leaves the model.

    kind: "tensor": a piece of a graph computes something else, or where none is off by itself is not what would be
        exported now; "trace": tracing itself changed the model; "optimiser": the graph is right until onnxruntime
        optimises it; "rounding": no tensor is off by itself, and all are made as they would be now; "dead input": a
        graph ignores an input; "stream input": the pipeline fed a graph wrongly; "stream output": it made something
        else of the right answers; "none": parity holds.
    tensor: of the graph, or its input. operators, module and source: what computes it, in the file and in the model.
    reads: what it is computed from. remarks: what is known of the cause. others: further places, not looked into.
    num_off, num_compared: tensors of the graph.
    """

    kind: Kind
    graph: str = ""
    frame: int = 0
    tensor: str = ""
    operators: tuple[str, ...] = ()
    module: str = ""
    source: str = ""
    error: TensorError | None = None
    reads: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    num_off: int = 0
    num_compared: int = 0
    others: tuple[str, ...] = ()

    @property
    def place(self) -> str:
        """As `graph.tensor`."""
        return f"{self.graph}.{self.tensor}" if self.graph else ""

    def to_dict(self) -> dict[str, Any]:
        """As JSON values; a number that is not finite becomes None."""
        return finite(asdict(self))


def bisect_parity(
    bundle: str | Path,
    model: DuoSpaceNet,
    frames: Sequence[Frame] | None = None,
    report: ParityResult | None = None,
    progress: Progress = no_progress,
    traces: Mapping[str, Trace] | None = None,
) -> Bisection:
    """Find the first place where `bundle` leaves `model`.

    frames: by default the scripted drive. report: what `check_parity` found on these frames, if it has been asked.
    traces: graphs of this very model that have been traced already, by name.
    Raises what `check_parity` raises.
    """
    pipeline = Pipeline.load(bundle, require_parity=False)
    size = pipeline.manifest.preprocessing
    frames = stress_sequence(size.width_px, size.height_px) if frames is None else frames
    report = report or check_parity(bundle, model, frames, progress=progress)
    if report.passed:
        return Bisection("none")
    search = _Search(Path(bundle), pipeline, EagerReference(model.eval(), size), frames, report, traces or {})
    if report.failing_outputs:
        graph, output, error = report.failing_outputs[0]
        return search.in_graph(graph, output, error.frame)
    return search.in_liveness(report.dead_inputs[0]) if report.dead_inputs else search.in_stream()


def trace_graph(graph: Graph, dcn: DeformableForm = "native") -> Trace:
    """Export a graph, its deformable convolutions in the form `dcn`, into a folder that is gone again."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / graph_file(graph.name)
        return Trace(trace(graph, path, dcn), onnx.load(path))


@dataclass(frozen=True)
class _Search:
    bundle: Path
    pipeline: Pipeline
    reference: EagerReference
    frames: Sequence[Frame]
    report: ParityResult
    traces: Mapping[str, Trace]

    def in_graph(self, name: str, output: str, frame: int) -> Bisection:
        """For a graph whose `output` is off where it is fed with eager's own inputs."""
        run, eager, file, fresh = self._runs(frame)[name], *self._open(name)
        changed = _worst(eager.values(run.outputs, run.inputs), run, frame)
        if not changed[1].relative <= GRAPH_TOLERANCE:
            return self._found("trace", name, frame, tensor=changed[0], error=changed[1])
        pieces = deviations(file, eager, run.inputs, frame)
        off = [piece for piece in pieces if not piece.error.relative <= GRAPH_TOLERANCE]
        counts = {"num_off": len(off), "num_compared": len(pieces)}
        if off:
            return self._found("tensor", name, frame, **_describe(off[0], eager, file, fresh), **counts)
        plain = _run_plainly(self.bundle / graph_file(name), run)
        if _worst(plain, run, frame)[1].relative <= GRAPH_TOLERANCE:
            error = self.report.graphs[name][output]
            return self._found("optimiser", name, frame, tensor=output, error=error, **counts)
        # A few wrong numbers may drown in a tensor with huge ones, such as the pixels of what lies behind a camera.
        other = next((piece for piece in pieces if differences(file, fresh, piece.piece.tensor)), None)
        if other:
            return self._found("tensor", name, frame, **_describe(other, eager, file, fresh), **counts)
        worst = max(pieces, key=lambda piece: piece.error.relative)
        return self._found("rounding", name, frame, **_describe(worst, eager, file, fresh), **counts)

    def in_liveness(self, dead: str) -> Bisection:
        """For an input, as `graph.input`, that no output depends on: who should have read it?"""
        graph, name = dead.split(".", 1)
        eager, file, fresh = self._open(graph)
        readers = [piece.tensor for piece in fresh.pieces.values() if name in piece.reads]
        origin = eager.origin(readers[0])
        remarks = tuple(line for reader in readers for line in differences(file, fresh, reader))
        return self._found("dead input", graph, tensor=name, remarks=remarks, **vars(origin))

    def in_stream(self) -> Bisection:
        """For a stream that goes wrong although every graph is right: what was it fed, in the first bad frame?"""
        frame = self.report.failing_frames[0]
        runs, recordings = self._runs(frame), record(self.pipeline, self.frames[: frame + 1])
        found = input_differences(recordings, runs, list(self.frames[frame].cameras), frame)
        if found:
            first, remarks = found[0], (found[0].remark,) if found[0].remark else ()
            others = tuple(f"{other.graph}.{other.name}" for other in found[1:])
            place = first.graph, frame, first.name
            return Bisection("stream input", *place, error=first.error, remarks=remarks, others=others)
        for name, recording in recordings.items():
            output, error = _worst(recording.outputs, runs[name], frame)
            if recording.outputs and not error.relative <= FEED_TOLERANCE:
                return Bisection("stream output", name, frame, output, error=error)
        return Bisection("stream output", frame=frame)

    def _runs(self, frame: int) -> dict[str, Run]:
        """Eager mode's graphs at a frame, after the frames that its window holds."""
        held = windows(self.frames, self.pipeline.manifest.window)
        for index in reversed(held[frame]):
            window = [past for past in held[index] if past in held[frame]]
            runs = self.reference.step(self.frames, window)
        return runs

    def _open(self, name: str) -> tuple[Intermediates, CutGraph, CutGraph]:
        """A graph in eager mode, as it lies in the bundle, and as it would be exported now."""
        graph = self.reference.graphs[cast("GraphName", name)]
        traced = self.traces.get(name) or trace_graph(graph, self.pipeline.manifest.dcn or "native")
        eager = Intermediates(traced.program, graph.outputs)
        file = onnx.load(self.bundle / graph_file(name))
        return eager, CutGraph(file, eager.names), CutGraph(traced.file, eager.names)

    def _found(self, kind: Kind, graph: str, frame: int = 0, **place: Any) -> Bisection:
        """With the other graphs and inputs that fail beside it."""
        outputs = [f"{other}.{name}" for other, name, _ in self.report.failing_outputs if other != graph]
        dead = [name for name in self.report.dead_inputs if name != f"{graph}.{place['tensor']}"]
        others = (*outputs, *(f"{name} (no output depends on it)" for name in dead))
        return Bisection(kind, graph, frame, others=others, **place)


def _describe(deviation: Deviation, eager: Intermediates, file: CutGraph, fresh: CutGraph) -> dict[str, Any]:
    piece = deviation.piece
    return {
        "tensor": piece.tensor,
        "operators": piece.operators,
        "error": deviation.error,
        "reads": piece.reads,
        "remarks": tuple(differences(file, fresh, piece.tensor)),
        **vars(eager.origin(piece.tensor)),
    }


def _worst(actual: Mapping[str, NDArray], run: Run, frame: int) -> tuple[str, TensorError]:
    """The output that is farthest off, of those in `actual`."""
    errors = {name: error_of(name, value, run.outputs[name].numpy(), frame) for name, value in actual.items()}
    return max(errors.items(), key=lambda item: item[1].relative)


def _run_plainly(path: Path, run: Run) -> dict[str, NDArray]:
    """The outputs of a graph file that is run as it lies, nothing fused."""
    names, feed = list(run.outputs), {name: value.numpy() for name, value in run.inputs.items()}
    return dict(zip(names, plain_session(path).run(names, feed), strict=True))
