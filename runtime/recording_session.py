"""Sessions that record the inputs and outputs of the graphs of a pipeline."""

from collections.abc import Mapping
from typing import cast

import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from .pipeline import Pipeline
from .session import Session, Tensors, to_tensors


class RecordingSession:
    """A session that keeps the inputs and outputs of its last run, without copies."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._inputs: Tensors = {}
        self._outputs: Tensors = {}

    @property
    def inputs(self) -> dict[str, NDArray]:
        """The inputs of the last run by name; empty before the first run."""
        return {name: value.numpy() for name, value in self._inputs.items()}

    @property
    def outputs(self) -> dict[str, NDArray]:
        """The outputs of the last run by name; empty before the first run."""
        return {name: value.numpy() for name, value in self._outputs.items()}

    def run(self, tensors: Mapping[str, ort.OrtValue]) -> Tensors:
        """Run the graph as `Session.run` does."""
        outputs = self._session.run(tensors)
        self._inputs, self._outputs = dict(tensors), outputs
        return outputs

    def forget(self) -> None:
        """Drop the recorded tensors."""
        self._inputs, self._outputs = {}, {}

    def outputs_for(self, inputs: Mapping[str, NDArray]) -> dict[str, NDArray]:
        """The outputs for `inputs`. If the last run had the same inputs, bit for bit, its outputs are returned."""
        recorded = self.inputs
        # A backbone that takes a few cameras at a time leaves out lost cameras, which `inputs` do not mention.
        all_cameras = "camera_valid" in inputs or bool(np.all(recorded.get("camera_valid", True)))
        if recorded and all_cameras and all(np.array_equal(value, recorded[name]) for name, value in inputs.items()):
            return self.outputs
        outputs = self._session.run(to_tensors(**inputs))
        return {name: value.numpy() for name, value in outputs.items()}


def recording_pipeline(pipeline: Pipeline) -> tuple[Pipeline, dict[str, RecordingSession]]:
    """A pipeline with the same graphs, and the sessions that record its runs, by graph."""
    recordings = {name: RecordingSession(session) for name, session in pipeline.sessions.items()}
    return pipeline.with_sessions(cast("dict[str, Session]", recordings)), recordings
