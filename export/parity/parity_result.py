"""The result of a parity check: measured errors, tolerances, and the failures as lines of text."""

from dataclasses import asdict, dataclass

from ...runtime.bundle.manifest import Precision
from ...runtime.bundle.parity_report import ParityReport, WeightMatchRecord
from ...runtime.parity.frame_error import FrameError
from ...runtime.parity.tensor_error import TensorError
from ...runtime.parity.tolerances import (
    describe_error,
    replace_nonfinite,
    size_of,
    stream_failures,
    tolerance_of,
    tolerances_for,
)
from .liveness import Liveness
from .manifest_differences import FieldDifference
from .retraced_graphs import Retrace
from .sequence_coverage import Coverage
from .weight_match import WeightMatch


@dataclass(frozen=True)
class ParityResult:
    """Everything that `check_parity` compared.

    source: name of the frames. frames: their number.
    graphs: the largest error by graph and output, on frames and on random inputs. The inputs were eager mode's.
    stream: the error of each frame. The pipeline ran as a stream, on its own cached values.
    coverage: what the stress sequence exercises. shortfalls: what it lacks, one line each.
    random_inputs: number of random inputs by graph.
    scales: RMS of each float tensor of a frame, by name; with a seed they give the random inputs again.
    liveness: the elements that were disturbed, by graph.
    manifest: fields that differ from those of the model's configuration and weights.
    weights: the comparison of the constants in the graphs with the model's weights; None if it was not requested.
    retrace: the comparison with a new export; None if it was not requested.
    precision: of the bundle; it decides the tolerances.
    quantization: what is wrong with the scales of quantized graphs, one line each.
    reference: what the bundle was compared with; None for eager PyTorch.
    """

    source: str
    frames: int
    graphs: dict[str, dict[str, TensorError]]
    stream: list[FrameError]
    coverage: Coverage
    shortfalls: list[str]
    random_inputs: dict[str, int]
    scales: dict[str, float]
    liveness: dict[str, Liveness]
    manifest: list[FieldDifference]
    weights: WeightMatch | None
    retrace: Retrace | None = None
    precision: Precision = "float32"
    quantization: tuple[str, ...] = ()
    reference: str | None = None

    @property
    def failing_outputs(self) -> list[tuple[str, str, TensorError]]:
        """Graph outputs outside the tolerance, as (graph, output, error)."""
        return [
            (graph, name, error)
            for graph, outputs in self.graphs.items()
            for name, error in outputs.items()
            # `not <=` instead of `>`, so that a NaN fails.
            if not size_of(error) <= tolerance_of(error)
        ]

    @property
    def failing_frames(self) -> list[int]:
        """Indices of the streamed frames outside the tolerances."""
        return [index for index, error in enumerate(self.stream) if stream_failures(index, error, self.precision)]

    @property
    def failures(self) -> list[str]:
        """All violations, one line each."""
        return [
            *(f"{graph}.{name}, {error.case}: {describe_error(error)}" for graph, name, error in self.failing_outputs),
            *(
                line
                for index, error in enumerate(self.stream)
                for line in stream_failures(index, error, self.precision)
            ),
            *(f"{name}: disturbed by itself, it changes the outputs differently" for name in self.wrong_elements),
            *(self.weights.failures if self.weights else ()),
            *self.quantization,
            *(self.retrace.differences if self.retrace else ()),
            *map(str, self.manifest),
            *self.shortfalls,
        ]

    @property
    def wrong_elements(self) -> list[str]:
        """Elements of inputs that change the outputs differently in the bundle, as `graph.input[place]`."""
        return [name for liveness in self.liveness.values() for name in liveness.wrong]

    @property
    def passed(self) -> bool:
        """Whether there is no violation."""
        return not self.failures

    def to_report(self) -> ParityReport:
        """The report for the manifest. Numbers that are not finite become None."""
        weights = self.weights
        report = {
            "reference": self.reference,
            "passed": self.passed,
            "failures": self.failures,
            "tolerances": tolerances_for(self.precision),
            "source": self.source,
            "frames": self.frames,
            "graphs": {graph: {name: asdict(e) for name, e in errors.items()} for graph, errors in self.graphs.items()},
            "stream": [asdict(error) for error in self.stream],
            "coverage": asdict(self.coverage),
            "random_inputs": self.random_inputs,
            "elements": {graph: liveness.elements for graph, liveness in self.liveness.items()},
            "wrong_elements": self.wrong_elements,
            "weights": weights and {name: getattr(weights, name) for name in WeightMatchRecord.model_fields},
            "retrace": self.retrace and {"graphs": self.retrace.graphs, "skipped": self.retrace.skipped},
        }
        return ParityReport.model_validate(replace_nonfinite(report))
