"""Runs a pipeline over the frames of a golden example from a cold start, and compares every tensor."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

from numpy.typing import NDArray

from .bundle.golden_record import INPUTS, MAPS, ExpectedFrame
from .detections import Detections
from .errors import ArtifactError
from .frame import Frame
from .golden_sampling import ValueDifference, first_difference, sampling_step
from .pipeline import Pipeline
from .recording_session import RecordingSession, recording_pipeline


class GoldenDifference(NamedTuple):
    """The first tensor of a frame that differs. frame: its number. token: of the frame. tensor: its name."""

    frame: int
    token: str
    tensor: str
    value: ValueDifference
    tolerance: float

    def __str__(self) -> str:
        index = ", ".join(map(str, self.value.index))
        return (
            f"frame {self.frame} ({self.token}), {self.tensor}[{index}]: expected {self.value.expected:.7g}; "
            f"got {self.value.found:.7g}; the tolerance is {self.tolerance:g}, and {self.value.differing} of "
            f"{self.value.compared} compared values differ"
        )


class GoldenRun(NamedTuple):
    """One frame of a golden example. difference: the first one, or None."""

    detections: Detections
    difference: GoldenDifference | None


def run_golden_frames(
    pipeline: Pipeline, frames: Iterable[Frame], expected: Sequence[ExpectedFrame]
) -> Iterator[GoldenRun]:
    """Run the frames as a new stream, and compare the tensors of each frame with the expected values.

    The caller stops at the first difference: those of later frames usually follow from it.
    Raises ArtifactError if the expected values are not those of the pipeline's graphs.
    """
    recording, sessions = recording_pipeline(pipeline)
    stream = recording.stream(maps="segmenter" in sessions)
    for number, (frame, values) in enumerate(zip(frames, expected, strict=True)):
        detections = stream.step(frame)
        tensors = recorded_tensors(pipeline, sessions)
        tensors |= {f"{MAPS}.{name}": probabilities for name, probabilities in detections.maps.items()}
        _check_names(number, values, tensors)
        yield GoldenRun(detections, _compare(number, values, tensors))


def recorded_tensors(pipeline: Pipeline, sessions: Mapping[str, RecordingSession]) -> dict[str, NDArray]:
    """Return the tensors of the last frame: `inputs.NAME` for those of the host, then `GRAPH.NAME` for outputs.

    The decoder's inputs take precedence over those of equal name of other graphs.
    """
    specs = pipeline.manifest.graphs
    produced = {tensor.name for spec in specs.values() for tensor in spec.outputs}
    inputs: dict[str, NDArray] = {}
    outputs: dict[str, NDArray] = {}
    for name in sorted(specs, key=lambda name: name == "decoder"):
        session = sessions[name]
        inputs |= {
            f"{INPUTS}.{tensor.name}": session.inputs[tensor.name]
            for tensor in specs[name].inputs
            if tensor.name not in produced and "." not in tensor.name
        }
    for name in specs:
        outputs |= {f"{name}.{tensor.name}": sessions[name].outputs[tensor.name] for tensor in specs[name].outputs}
    return inputs | outputs


def _check_names(number: int, expected: ExpectedFrame, tensors: Mapping[str, NDArray]) -> None:
    """Check that the expected values are those of exactly these tensors. Raises ArtifactError."""
    where = f"golden/expected.json: field frames.{number}.tensors"
    if expected.tensors.keys() != tensors.keys():
        name = sorted(expected.tensors.keys() ^ tensors.keys())[0]
        problem = f"{name!r} is missing" if name in tensors else f"got {name!r}, which no graph has"
        raise ArtifactError(f"{where}: expected values of exactly the graphs' tensors; {problem}. Export again.")
    for name, tensor in tensors.items():
        values = expected.tensors[name]
        if (values.shape, values.dtype) != (tensor.shape, tensor.dtype.name):
            raise ArtifactError(
                f"{where}.{name}: expected {tensor.dtype.name} {tensor.shape}, as in the graphs; got {values.dtype} "
                f"{values.shape}. Export again."
            )
        step = sampling_step(name, tensor.shape)
        if (values.step, len(values.values)) != (step, len(tensor.ravel()[::step])):
            raise ArtifactError(
                f"{where}.{name}: expected {len(tensor.ravel()[::step])} values with step {step}; got "
                f"{len(values.values)} with step {values.step}. Export again."
            )


def _compare(number: int, expected: ExpectedFrame, tensors: Mapping[str, NDArray]) -> GoldenDifference | None:
    for name, values in expected.tensors.items():
        if difference := first_difference(name, values, tensors[name]):
            return GoldenDifference(number, expected.token, name, difference, values.tolerance)
    return None
