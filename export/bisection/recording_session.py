"""Sessions that record the inputs and outputs of the graphs of a pipeline."""

from collections.abc import Mapping, Sequence
from typing import cast

import onnxruntime as ort
from numpy.typing import NDArray

from ...runtime import Frame, Pipeline
from ...runtime.session import Session, Tensors


class RecordingSession:
    """A session that keeps copies of the inputs and outputs of its last run, by name."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self.inputs: dict[str, NDArray] = {}
        self.outputs: dict[str, NDArray] = {}

    def run(self, tensors: Mapping[str, ort.OrtValue]) -> Tensors:
        outputs = self._session.run(tensors)
        self.inputs = {name: value.numpy().copy() for name, value in tensors.items()}
        self.outputs = {name: value.numpy().copy() for name, value in outputs.items()}
        return outputs


def record_last_frame(pipeline: Pipeline, frames: Sequence[Frame]) -> dict[str, RecordingSession]:
    """Run a new stream over `frames` and record each graph's inputs and outputs for the last one.

    A graph that did not run for the last frame has empty inputs and outputs: for example the projector, which runs only
    when the calibration changes.
    """
    recordings = {name: RecordingSession(session) for name, session in pipeline.sessions.items()}
    recorded_pipeline = Pipeline(pipeline.manifest, cast("dict[str, Session]", recordings))
    stream = recorded_pipeline.stream(maps="segmenter" in recordings)
    for frame in frames:
        for recording in recordings.values():
            recording.inputs, recording.outputs = {}, {}
        stream.step(frame)
    return recordings
