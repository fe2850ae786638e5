"""Compares an engine with a golden file: single graphs, and the frames as a stream. Needs no PyTorch."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import asdict, dataclass, field, replace

from numpy.typing import NDArray

from ..bundle.manifest import GraphName, Manifest
from ..bundle.parity_report import ParityReport
from ..camera_groups import CameraGroups
from ..pipeline import Pipeline
from ..progress import Progress
from ..session import to_tensors
from .frame_error import FrameError
from .golden_file import GoldenFile
from .golden_file_record import CaseRecord
from .tensor_error import TensorError
from .tolerances import INT8_TOLERANCES, SCORE_TOLERANCE, replace_nonfinite, stream_failures, tolerances_for
from .worst_errors import WorstErrors

OutputsOfCase = Callable[[CaseRecord], Mapping[str, NDArray]]  # the outputs of the engine under test, by name


@dataclass
class GoldenParity:
    """Compares, and collects the errors.

    quantized: names of the quantized graphs. They are not compared on random inputs, which are outside the ranges of
        their activations.
    """

    golden: GoldenFile
    manifest: Manifest
    quantized: Collection[GraphName] = ()
    errors: WorstErrors = field(default_factory=WorstErrors)
    stream: list[FrameError] = field(default_factory=list)
    random_inputs: dict[str, int] = field(default_factory=dict)

    def compared_cases(self) -> list[CaseRecord]:
        """The cases of single graphs that are compared."""
        return [case for case in self.golden.cases if case.seed is None or case.graph not in self.quantized]

    def add_cases(self, outputs_of: OutputsOfCase, progress: Progress) -> None:
        """Compare the outputs of single graphs with those of the golden file."""
        for case in progress(self.compared_cases(), "single graphs"):
            actual = outputs_of(case)
            if case.seed is not None:
                self.random_inputs[case.graph] = self.random_inputs.get(case.graph, 0) + 1
            heading = self.golden.heading(case, self.manifest)
            for name, expected in self.golden.outputs(case, self.manifest.graphs[case.graph]).items():
                error = TensorError.between_outputs(name, actual[name], expected, heading=heading)
                is_quantized = case.graph in self.quantized
                error = replace(error, frame=case.frame, seed=case.seed, quantized=is_quantized)
                self.errors.add(case.graph, name, error)

    def add_stream(self, pipeline: Pipeline, progress: Progress) -> None:
        """Run the frames as a stream, and compare its results."""
        stream = pipeline.stream(maps="segmenter" in pipeline.sessions)
        tolerance = INT8_TOLERANCES.score if self.quantized else SCORE_TOLERANCE
        for index in progress(range(len(self.golden.about.stream)), "stress sequence"):
            frame, window, outputs, heading = self.golden.frame(index, self.manifest)
            detections = stream.step(frame)
            if not window:
                self.stream.append(FrameError.of_skipped_frame(detections))
                continue
            classes = self.golden.about.classes
            self.stream.append(FrameError.between(detections, outputs, classes, window, tolerance, heading))

    def to_report(self) -> ParityReport:
        """The report of everything so far."""
        precision = self.manifest.precision
        failures = list(self.errors.failures())
        for index, error in enumerate(self.stream):
            failures += stream_failures(index, error, precision)
        report = {
            "reference": f"eager mode's values in {self.golden.path.name}",
            "passed": not failures,
            "failures": failures,
            "tolerances": tolerances_for(precision),
            "source": "stress sequence" if self.stream else "single graphs of the stress sequence",
            "frames": len(self.stream),
            "graphs": {
                graph: {name: asdict(error) for name, error in outputs.items()}
                for graph, outputs in self.errors.by_graph.items()
            },
            "stream": [asdict(error) for error in self.stream],
            "random_inputs": self.random_inputs,
        }
        return ParityReport.model_validate(replace_nonfinite(report))


def engine_outputs(golden: GoldenFile, pipeline: Pipeline) -> OutputsOfCase:
    """Return a function that runs the graph of a case in the engine of a pipeline."""

    def outputs_of(case: CaseRecord) -> dict[str, NDArray]:
        session = pipeline.sessions[case.graph]
        session = session.session if isinstance(session, CameraGroups) else session
        inputs = golden.inputs(case, pipeline.manifest.graphs[case.graph])
        return {name: value.numpy() for name, value in session.run(to_tensors(**inputs)).items()}

    return outputs_of
