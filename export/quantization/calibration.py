"""Calibration: the range of every tensor that may be quantized, measured frame by frame."""

import copy
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray
from onnxruntime.quantization import CalibrationDataReader, MinMaxCalibrater, TensorsData

from ...runtime import Pipeline
from ...runtime.bundle.manifest import GraphName
from ...runtime.camera_groups import CameraGroups
from ...runtime.session import Session, Tensors
from ...runtime.termination import terminable
from ..bisection.pieces import unoptimised_session
from .blocks import CONVOLUTIONAL


class GraphCalibration:
    """Measures the ranges of one float32 graph's tensors.

    Every run updates the ranges at once, so the memory does not grow with the number of frames.
    """

    def __init__(self, graph: Path, folder: Path, operators: Sequence[str] = CONVOLUTIONAL) -> None:
        """graph: the file. folder: an empty folder for temporary files, which must exist as long as this object.

        operators: those that may be quantized.
        """
        # onnxruntime writes further files beside the graph, so it gets a copy in the temporary folder.
        copied = folder / graph.name
        copied.write_bytes(graph.read_bytes())
        self._calibrater = _SharedPoolCalibrater(copied, list(operators), str(folder / f"augmented_{graph.name}"))
        self._calibrater.augment_graph()
        self._calibrater.create_inference_session()

    def add(self, inputs: Mapping[str, NDArray]) -> None:
        """Run the graph on the inputs of one run, by name, and widen the ranges."""
        self._calibrater.collect_data(_OneRun(inputs))

    def ranges(self) -> TensorsData:
        """A copy of the smallest and largest value of each tensor. Needs at least one run."""
        return copy.deepcopy(self._calibrater.compute_data())


class _CalibratingSession:
    """A session whose inputs also go to a calibration, at every run: a graph may run several times per frame."""

    def __init__(self, session: Session, calibration: GraphCalibration) -> None:
        self._session, self._calibration = session, calibration
        self.precision = session.precision

    def run(self, tensors: Mapping[str, ort.OrtValue]) -> Tensors:
        self._calibration.add({name: value.numpy() for name, value in tensors.items()})
        return self._session.run(tensors)


def calibrating_pipeline(pipeline: Pipeline, calibrations: Mapping[GraphName, GraphCalibration]) -> Pipeline:
    """A pipeline with the same graphs, whose runs also go to the calibration of their graph."""
    sessions = dict(pipeline.sessions)
    for name, calibration in calibrations.items():
        session = sessions[name]
        # Where the backbone runs group by group, the pipeline divides the cameras in front of this session again.
        single = session.session if isinstance(session, CameraGroups) else session
        sessions[name] = _CalibratingSession(single, calibration)
    return Pipeline(pipeline.manifest, sessions)


class _OneRun(CalibrationDataReader):
    """The inputs of one run, in the form that onnxruntime's calibration reads."""

    def __init__(self, inputs: Mapping[str, NDArray]) -> None:
        self._inputs: Mapping[str, NDArray] | None = inputs

    def get_next(self) -> dict[str, NDArray] | None:
        inputs, self._inputs = self._inputs, None
        return None if inputs is None else dict(inputs)


class _SharedPoolCalibrater(MinMaxCalibrater):
    """onnxruntime's calibration on the thread pool that all sessions of the process share."""

    def create_inference_session(self) -> None:
        # onnxruntime refuses a session with its own thread pool once the process has a shared one.
        self.infer_session = _TerminableSession(unoptimised_session(Path(self.augmented_model_path)))


class _TerminableSession:
    """The part of onnxruntime's session that the calibration uses. Ctrl-C ends a run after its current operator."""

    def __init__(self, session: ort.InferenceSession) -> None:
        self._session = session
        self._names = {node.name for node in session.get_inputs()}
        self.get_outputs = session.get_outputs

    def run(self, names: None, inputs: Mapping[str, NDArray]) -> list[NDArray[np.float32]]:
        options = ort.RunOptions()
        with terminable(lambda: setattr(options, "terminate", True)):
            return self._session.run(
                names, {name: value for name, value in inputs.items() if name in self._names}, options
            )
