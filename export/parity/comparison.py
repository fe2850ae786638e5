"""Comparison of a bundle with eager mode: graph by graph on equal inputs, and as a stream."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

from numpy.typing import NDArray
from torch import Tensor

from ...runtime import Frame, Pipeline
from ...runtime.bundle.manifest import GraphName
from ...runtime.parity.frame_error import FrameError
from ...runtime.parity.tensor_error import TensorError
from ...runtime.parity.tolerances import INT8_TOLERANCES, RANDOM_TOLERANCE, SCORE_TOLERANCE
from ...runtime.parity.worst_errors import WorstErrors
from ...runtime.progress import Progress
from ...runtime.recording_session import recording_pipeline
from ...weights.input_contract import temporal_window
from .activation_scales import DequantizedSession
from .expected_windows import expected_windows
from .liveness import Liveness, check_liveness
from .quantized_liveness import Responses
from .random_inputs import RandomInputs
from .reference import EagerReference, GraphRun

# These graphs get one random input for so many of another graph: they take longest, and images and features are
# generic in every frame anyway.
_FEWER_RANDOM_INPUTS = {"backbone": 6, "lifter": 3}


class Comparison:
    """Compares a bundle with the reference, and collects the errors.

    graph_errors: the largest error so far by graph and output, relative to its tolerance.
    stream_errors: the error of each streamed frame.
    scales: RMS of each output of a graph in eager mode, by name. Features are outputs before they are inputs, so
        this is the scale of random inputs.
    """

    def __init__(
        self, pipeline: Pipeline, reference: EagerReference, dequantized: Mapping[str, DequantizedSession] | None = None
    ) -> None:
        """dequantized: the dequantized form of each quantized graph, by graph name."""
        self._pipeline, self._sessions = recording_pipeline(pipeline)
        self._reference = reference
        self._dequantized = dequantized or {}
        self._worst = WorstErrors()
        self.graph_errors = self._worst.by_graph
        self.stream_errors: list[FrameError] = []
        self.scales: dict[str, float] = {}

    def add_sequence(self, frames: Sequence[Frame], first: int, progress: Progress, label: str) -> list[list[int]]:
        """Compare consecutive frames of one vehicle, with a new stream. Returns the window of each frame.

        first: number of the first frame, for the errors.
        label: name of the frames, for the progress.
        """
        stream = self._pipeline.stream(maps="segmenter" in self._sessions)
        windows = expected_windows(frames, temporal_window(self._reference.config))
        for index, window in enumerate(progress(windows, label)):
            detections = stream.step(frames[index])
            if not window:
                self.stream_errors.append(FrameError.of_skipped_frame(detections))
                continue
            runs = self._reference.step(frames, window)
            for name, run in runs.items():
                self._add_errors(name, self._errors(name, run), frame=first + index)
                update_scales(self.scales, run)
                if name in self._dequantized:
                    self._dequantized[name].measure(arrays(run.inputs))
            maps = runs["segmenter"].outputs if "segmenter" in runs else {}
            outputs = arrays(runs["decoder"].outputs | maps)
            classes = self._reference.config.classes
            self.stream_errors.append(
                FrameError.between(
                    detections, outputs, classes, len(window), self._score_tolerance, runs["decoder"].heading_array()
                )
            )
        return windows

    def add_random_inputs(self, number: int, progress: Progress) -> dict[str, int]:
        """Compare every graph on random inputs. Returns their number by graph."""
        counts: dict[str, int] = {
            name: -(-number // _FEWER_RANDOM_INPUTS.get(name, 1)) for name in self._reference.graphs
        }
        for name, graph in self._reference.graphs.items():
            for seed in progress(range(counts[name]), f"random inputs of {name}"):
                inputs = RandomInputs(self._reference.model, self.scales, seed).sample(graph)
                self._add_errors(name, self._run(name, inputs), seed=seed)
        return counts

    def check_liveness(self, seed: int, progress: Progress) -> dict[str, Liveness]:
        """Disturb every element of every input, beside random inputs with every slot and camera valid.

        seed: of the random inputs. If a graph differs on them before any element is disturbed, its error is kept, and
            its elements are not disturbed.
        """
        results: dict[str, Liveness] = {}
        for graph in progress(list(self._reference.graphs.values()), "single elements of the inputs"):
            inputs = RandomInputs(self._reference.model, self.scales, seed).sample(graph, all_valid=True)
            if graph.name in self._dequantized:
                is_equal = self._responses(graph.name, inputs).are_equal
                results[graph.name] = check_liveness(graph, inputs, is_equal, one_by_one=True)
                continue
            errors = self._run(graph.name, inputs)
            if _are_small(errors):
                results[graph.name] = check_liveness(graph, inputs, partial(self._is_equal, graph.name))
            else:
                self._add_errors(graph.name, errors, seed=seed)
        return results

    def scale_failures(self) -> list[str]:
        """The activations of quantized graphs whose scale does not fit the frames so far, one line each."""
        return [f"{name}.{line}" for name, session in self._dequantized.items() for line in session.scale_failures()]

    @property
    def _score_tolerance(self) -> float:
        return INT8_TOLERANCES.score if self._dequantized else SCORE_TOLERANCE

    def _responses(self, name: GraphName, inputs: Mapping[str, Tensor]) -> Responses:
        dequantized = self._dequantized[name]
        return Responses(
            inputs,
            reference=lambda tensors: arrays(self._reference.run(name, tensors).outputs),
            dequantized=lambda tensors: dequantized.outputs_for(arrays(tensors)),
        )

    def _is_equal(self, name: GraphName, inputs: Mapping[str, Tensor]) -> bool:
        return _are_small(self._run(name, inputs))

    def _run(self, name: GraphName, inputs: Mapping[str, Tensor]) -> dict[str, TensorError]:
        """Run a graph on both sides. Returns the error of each output.

        The dequantized form of a quantized graph runs: random inputs are outside the ranges of its activations.
        """
        return self._errors(name, self._reference.run(name, inputs), self._dequantized.get(name))

    def _add_errors(
        self, name: str, errors: Mapping[str, TensorError], frame: int | None = None, seed: int | None = None
    ) -> None:
        for output, error in errors.items():
            error = replace(error, frame=frame, seed=seed, quantized=name in self._dequantized)
            self._worst.add(name, output, error)

    def _errors(
        self, name: str, run: GraphRun, dequantized: DequantizedSession | None = None
    ) -> dict[str, TensorError]:
        actual = (dequantized or self._sessions[name]).outputs_for(arrays(run.inputs))
        return {
            output: TensorError.between_outputs(output, actual[output], expected, heading=run.heading_array())
            for output, expected in arrays(run.outputs).items()
        }


def _are_small(errors: Mapping[str, TensorError]) -> bool:
    return all(error.relative <= RANDOM_TOLERANCE for error in errors.values())


def update_scales(scales: dict[str, float], run: GraphRun) -> None:
    """Keep the larger RMS of each output, by name: that of the run or that in `scales`."""
    for name, value in run.outputs.items():
        scales[name] = max(scales.get(name, 0.0), float(value.float().square().mean().sqrt()))


def arrays(values: Mapping[str, Tensor]) -> dict[str, NDArray]:
    """The tensors as arrays that share their memory."""
    return {name: value.numpy() for name, value in values.items()}
