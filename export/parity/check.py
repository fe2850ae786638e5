"""The parity check: run eager mode and a bundle side by side, graph by graph and as a stream."""

from collections.abc import Sequence
from pathlib import Path

from numpy.typing import NDArray
from torch import Tensor

from ...model import DuoSpaceNet
from ...runtime import Frame, Pipeline
from ...runtime.errors import ArtifactError, InputError
from ...runtime.progress import Progress, no_progress
from ...runtime.session import to_tensors
from ..manifest_builder import graph_spec
from .expected_windows import expected_windows
from .frame_error import FrameError
from .liveness import fill_empty_slots, unused_inputs
from .parity_result import SCORE_TOLERANCE, ParityResult
from .reference import EagerReference, GraphRun
from .stress_sequence import stress_sequence
from .tensor_error import TensorError


def check_parity(
    bundle: str | Path,
    model: DuoSpaceNet,
    frames: Sequence[Frame] | None = None,
    source: str = "stress sequence",
    progress: Progress = no_progress,
) -> ParityResult:
    """Compare `bundle` with `model` in eager mode on `frames`.

    The check has three parts:
    - Each graph runs on eager mode's inputs.
    - The pipeline runs as a stream, on its own cached values.
    - Each input of each graph is changed once, to find inputs that no output depends on.

    frames: consecutive frames; by default the stress sequence.
    source: name of the frames, for the report.

    Raises ArtifactError if the bundle is damaged or its graphs have other inputs or outputs than the model's. Raises
    InputError if there are no frames or a frame is invalid.
    """
    pipeline = Pipeline.load(bundle, require_parity=False)
    preprocessing = pipeline.manifest.preprocessing
    if frames is None:
        frames = stress_sequence(preprocessing.width_px, preprocessing.height_px)
    if not frames:
        raise InputError(f"{source}: expected at least one frame; got none.")
    reference = EagerReference(model.eval(), preprocessing)
    _check_same_tensors(Path(bundle), pipeline, reference)
    comparison, windows = _BundleComparison(pipeline, frames), expected_windows(frames, pipeline.manifest.window)
    # With the most slots filled, the most inputs have an effect.
    longest, dead_inputs = max(windows, key=len), []
    for window in progress(windows, "parity"):
        runs = reference.step(frames, window)
        comparison.add_frame(runs, window)
        # Checked here and not after the loop, so that only one frame's tensors are in memory.
        if window is longest:
            dead_inputs = comparison.unused_inputs(runs, progress)
    return ParityResult(
        source=source,
        frames=len(frames),
        graphs=comparison.graph_errors(),
        stream=comparison.stream_errors,
        dead_inputs=dead_inputs,
    )


class _BundleComparison:
    """Compares a bundle with the reference frame by frame, and collects the errors."""

    def __init__(self, pipeline: Pipeline, frames: Sequence[Frame]) -> None:
        self._pipeline, self._frames = pipeline, frames
        self._stream = pipeline.stream(maps="segmenter" in pipeline.sessions)
        self._tensor_errors: list[dict[str, dict[str, TensorError]]] = []
        self.stream_errors: list[FrameError] = []

    def add_frame(self, runs: dict[str, GraphRun], window: Sequence[int]) -> None:
        """Compare the newest frame of `window`.

        runs: the reference's inputs and outputs for this frame, by graph.
        """
        self._tensor_errors.append({name: self._output_errors(name, run, window[0]) for name, run in runs.items()})
        maps = runs["segmenter"].outputs if "segmenter" in runs else {}
        expected = _arrays(runs["decoder"].outputs | maps)
        detections = self._stream.step(self._frames[window[0]])
        classes = self._pipeline.manifest.classes
        self.stream_errors.append(FrameError.between(detections, expected, classes, len(window), SCORE_TOLERANCE))

    def graph_errors(self) -> dict[str, dict[str, TensorError]]:
        """The worst error of all frames, by graph and output."""
        return {
            graph: {name: TensorError.worst([frame[graph][name] for frame in self._tensor_errors]) for name in outputs}
            for graph, outputs in self._tensor_errors[0].items()
        }

    def unused_inputs(self, runs: dict[str, GraphRun], progress: Progress) -> list[str]:
        """Inputs that no output of their graph depends on, as `graph.input`.

        runs: the reference's inputs, by graph. One input at a time is changed.
        """
        unused = []
        for graph, run in runs.items():
            inputs = _arrays(run.inputs)
            typical = fill_empty_slots(inputs) if graph == "decoder" else inputs
            names = progress(list(typical), f"checking the inputs of {graph}")
            unused += [f"{graph}.{name}" for name in unused_inputs(self._pipeline.sessions[graph], typical, names)]
        return unused

    def _output_errors(self, graph: str, run: GraphRun, frame: int) -> dict[str, TensorError]:
        actual = self._pipeline.sessions[graph].run(to_tensors(**_arrays(run.inputs)))
        return {
            name: TensorError.between_outputs(name, actual[name].numpy(), expected, frame)
            for name, expected in _arrays(run.outputs).items()
        }


def _check_same_tensors(bundle: Path, pipeline: Pipeline, reference: EagerReference) -> None:
    """Raise ArtifactError if the bundle has other graphs, inputs or outputs than the model."""
    if reference.graphs.keys() != pipeline.sessions.keys():
        raise ArtifactError(
            f"{bundle}: expected the model's graphs {', '.join(reference.graphs)}; got "
            f"{', '.join(pipeline.sessions)}. Use the checkpoint that the bundle was exported from."
        )
    for name, graph in reference.graphs.items():
        expected, actual = graph_spec(graph, ""), pipeline.manifest.graphs[name]
        if (expected.inputs, expected.outputs) != (actual.inputs, actual.outputs):
            raise ArtifactError(
                f"{bundle / actual.file}: expected the inputs and outputs of the model's {name} graph; got different "
                "inputs or outputs. Use the checkpoint that the bundle was exported from."
            )


def _arrays(values: dict[str, Tensor]) -> dict[str, NDArray]:
    return {name: value.numpy() for name, value in values.items()}
