"""The proof: eager mode and a bundle side by side, graph by graph and as a stream."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from ...model import DuoSpaceNet
from ...runtime import Frame, Pipeline
from ...runtime.bundle.manifest import slot_name
from ...runtime.bundle.parity_report import ParityReport
from ...runtime.errors import ArtifactError, InputError
from ...runtime.progress import Progress, no_progress
from ...runtime.session import tensors
from ..manifest_builder import describe
from .comparison import FrameError, TensorError
from .liveness import dead_inputs
from .reference import EagerReference, Run
from .stress_sequence import stress_sequence, windows

GRAPH_TOLERANCE = 1e-4  # of a tensor's largest error, relative to the reference's RMS
BOX_TOLERANCE = 1e-3  # m, rad, m/s
SCORE_TOLERANCE = 1e-3


@dataclass(frozen=True)
class ParityResult:
    """What `check_parity` measured.

    graphs: each graph's outputs by name, the worst of all frames, each graph fed with eager's own inputs.
    stream: one entry a frame, the pipeline fed with its own state. dead_inputs: `graph.input` names.
    """

    source: str
    frames: int
    graphs: dict[str, dict[str, TensorError]]
    stream: list[FrameError]
    dead_inputs: list[str]

    @property
    def failing_outputs(self) -> list[tuple[str, str, TensorError]]:
        """Graphs' outputs that are out of tolerance: graph, output, error."""
        return [
            (graph, name, error)
            for graph, outputs in self.graphs.items()
            for name, error in outputs.items()
            if not error.relative <= GRAPH_TOLERANCE
        ]

    @property
    def failing_frames(self) -> list[int]:
        """Streamed frames that are out of tolerance."""
        return [index for index, error in enumerate(self.stream) if _stream_failures(index, error)]

    @property
    def failures(self) -> list[str]:
        """What is out of tolerance, a line each."""
        return [
            *(
                f"{graph}.{name}, frame {error.frame}: relative error {error.relative:.2g}, above {GRAPH_TOLERANCE:g}"
                for graph, name, error in self.failing_outputs
            ),
            *(line for index, error in enumerate(self.stream) for line in _stream_failures(index, error)),
            *(f"{name}: no output depends on this input" for name in self.dead_inputs),
        ]

    @property
    def passed(self) -> bool:
        return not self.failures

    def to_report(self) -> ParityReport:
        """As the manifest holds it; a number that is not finite becomes None."""
        tolerances = {"graph": GRAPH_TOLERANCE, "box": BOX_TOLERANCE, "score": SCORE_TOLERANCE}
        verdict = {"passed": self.passed, "failures": self.failures, "tolerances": tolerances}
        return ParityReport.model_validate(finite(verdict | asdict(self)))


def check_parity(
    bundle: str | Path,
    model: DuoSpaceNet,
    frames: Sequence[Frame] | None = None,
    source: str = "scripted drive",
    progress: Progress = no_progress,
) -> ParityResult:
    """Run `model` in eager mode and the bundle over `frames`, by default the scripted drive, and compare.

    Per graph, fed with eager's inputs; streamed from end to end; and every declared input disturbed once.
    Raises ArtifactError for a broken bundle, InputError for frames that cannot be right.
    """
    pipeline = Pipeline.load(bundle, require_parity=False)
    preprocessing = pipeline.manifest.preprocessing
    if frames is None:
        frames = stress_sequence(preprocessing.width_px, preprocessing.height_px)
    if not frames:
        raise InputError(f"{source}: expected at least one frame; got none.")
    reference = EagerReference(model.eval(), preprocessing)
    _check_same_tensors(Path(bundle), pipeline, reference)
    comparison, held = _Comparison(pipeline, frames), windows(frames, pipeline.manifest.window)
    fullest, dead = max(held, key=len), []
    for window in progress(held, "parity"):
        runs = reference.step(frames, window)
        comparison.add(runs, window)
        if window is fullest:  # at once: what a window holds is large
            dead = comparison.dead_inputs(runs, progress)
    return ParityResult(
        source=source,
        frames=len(frames),
        graphs=comparison.graph_errors(),
        stream=comparison.stream_errors,
        dead_inputs=dead,
    )


class _Comparison:
    """Holds a bundle against the reference, frame by frame."""

    def __init__(self, pipeline: Pipeline, frames: Sequence[Frame]) -> None:
        self._pipeline, self._frames = pipeline, frames
        self._stream = pipeline.stream(maps="segmenter" in pipeline.sessions)
        self._tensor_errors: list[dict[str, dict[str, TensorError]]] = []
        self.stream_errors: list[FrameError] = []

    def add(self, runs: dict[str, Run], window: Sequence[int]) -> None:
        """Compare one frame, whose graphs the reference has run as `runs`."""
        self._tensor_errors.append({name: self._errors_of(name, run, window[0]) for name, run in runs.items()})
        maps = runs["segmenter"].outputs if "segmenter" in runs else {}
        expected = _arrays(runs["decoder"].outputs | maps)
        detections = self._stream.step(self._frames[window[0]])
        classes = self._pipeline.manifest.classes
        self.stream_errors.append(FrameError.between(detections, expected, classes, len(window), SCORE_TOLERANCE))

    def graph_errors(self) -> dict[str, dict[str, TensorError]]:
        """The worst of all frames, by graph and output."""
        return {
            graph: {name: TensorError.worst([frame[graph][name] for frame in self._tensor_errors]) for name in outputs}
            for graph, outputs in self._tensor_errors[0].items()
        }

    def dead_inputs(self, runs: dict[str, Run], progress: Progress) -> list[str]:
        """Inputs, as `graph.input`, that no output depends on where the reference has run the graphs as `runs`."""
        dead = []
        for name, run in runs.items():
            inputs = _arrays(run.inputs)
            feed = fill_window(inputs) if name == "decoder" else inputs
            session, names = self._pipeline.sessions[name], progress(list(feed), f"liveness of {name}")
            dead += [f"{name}.{dead_input}" for dead_input in dead_inputs(session, feed, names)]
        return dead

    def _errors_of(self, name: str, run: Run, frame: int) -> dict[str, TensorError]:
        actual = self._pipeline.sessions[name].run(tensors(**_arrays(run.inputs)))
        return {
            key: _compare(key)(actual[key].numpy(), expected, frame) for key, expected in _arrays(run.outputs).items()
        }


def fill_window(inputs: dict[str, NDArray]) -> dict[str, NDArray]:
    """Decoder inputs with the current frame standing in every empty slot, so that none is masked."""
    filled = {name: value.copy() for name, value in inputs.items()}
    for slot in np.flatnonzero(~inputs["frame_valid"]).tolist():
        for name, value in filled.items():
            if name.startswith(slot_name(slot, "")):
                filled[name] = inputs[slot_name(0, name.split(".", 1)[1])]
            elif not name.startswith("slot"):
                value[slot] = inputs[name][0]
    return filled


def _check_same_tensors(bundle: Path, pipeline: Pipeline, reference: EagerReference) -> None:
    """A model whose graphs take or give other tensors is another model: nothing could be compared."""
    if reference.graphs.keys() != pipeline.sessions.keys():
        raise ArtifactError(
            f"{bundle}: expected the graphs {', '.join(reference.graphs)} of this model; got "
            f"{', '.join(pipeline.sessions)}. Name the checkpoint, and the bundle, that belong together."
        )
    for name, graph in reference.graphs.items():
        expected, got = describe(graph, ""), pipeline.manifest.graphs[name]
        if (expected.inputs, expected.outputs) != (got.inputs, got.outputs):
            raise ArtifactError(
                f"{bundle / got.file}: expected the {name} graph of this model; got one with other tensors. "
                "Name the checkpoint, and the bundle, that belong together."
            )


def _compare(name: str) -> Callable[[NDArray, NDArray, int], TensorError]:
    return TensorError.between_boxes if name == "boxes" else TensorError.between


def _arrays(values: dict[str, Tensor]) -> dict[str, NDArray]:
    return {name: value.numpy() for name, value in values.items()}


def _stream_failures(index: int, error: FrameError) -> list[str]:
    limits = [
        ("box", error.box, BOX_TOLERANCE),
        ("score", error.score, SCORE_TOLERANCE),
        ("map", error.map, SCORE_TOLERANCE),
        ("unmatched boxes", error.unmatched, 0),
        ("history, frames off", abs(error.history), 0),
    ]
    return [
        f"stream, frame {index}: {what} {value:.3g}, above {limit:g}"
        for what, value, limit in limits
        if not value <= limit
    ]


def finite(value: Any) -> Any:
    """The same values with None for numbers that are not finite, which JSON has not."""
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value
