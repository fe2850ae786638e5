"""The report of a benchmark: the JSON object of `duospacenet bench --json`, and its parts."""

from typing import Annotated, Final, Literal

from pydantic import Field

from ...runtime.json_record import FiniteFloat, JsonRecord, Name, PositiveFloat, PositiveInt

REPORT_KIND: Final = "duospacenet bench"
REPORT_SCHEMA: Final = 1
MAX_REPORT_BYTES = 2**24

# Stages of the host code. The other stages are graphs, or the whole model of an alternative.
HOST_STAGES = ("preprocess", "postprocess")

Share = Annotated[float, Field(strict=True, ge=0, le=1)]
Duration = Annotated[float, Field(strict=True, ge=0, allow_inf_nan=False)]


class Percentiles(JsonRecord):
    """Percentiles of a duration [ms]. A percentile is None if there are too few samples for it."""

    p50: Duration
    p90: Duration | None
    p99: Duration | None
    p99_9: Duration | None


class TargetReport(JsonRecord):
    """The figures of one target: the bundle, or an alternative.

    kind: the kind of target. description: one line on its model, precision and weights.
    queries: number of measured frames.
    load_s: from the files to a loaded model, without the start of the process and the imports.
    first_frame_ms: the first frame after loading.
    peak_memory_gb: of the process, which also holds the decoded frames.
    frame_ms: duration of a whole frame. stages_ms: by stage, in the order in which they run.
    versions: of the libraries in its process.
    """

    kind: Name
    description: Name
    queries: PositiveInt
    load_s: Duration
    first_frame_ms: Duration
    peak_memory_gb: PositiveFloat
    frame_ms: Percentiles
    stages_ms: dict[Name, Percentiles]
    versions: dict[Name, Name]


class RatioRecord(JsonRecord):
    """How many times longer a frame of the alternative takes than a frame of the bundle.

    median, q1, q3: the median and the quartiles of the ratios of all rounds.
    """

    median: PositiveFloat
    q1: PositiveFloat
    q3: PositiveFloat


class ColdStartRecord(JsonRecord):
    """The first frame of a stream, with a window of one frame, beside a frame with a full window.

    ratio: full window / first frame, the median over the rounds.
    """

    window: PositiveInt
    first_frame_ms: Duration
    full_window_ms: Duration
    ratio: PositiveFloat


class ThroughputRecord(JsonRecord):
    """Streams in threads that share one pipeline. frames_per_s: of all streams together."""

    streams: PositiveInt
    frames: PositiveInt
    frames_per_s: PositiveFloat
    peak_memory_gb: PositiveFloat


class OperatorRecord(JsonRecord):
    """The time of one kind of operator in one graph, by onnxruntime's profiler.

    calls_per_frame: number of nodes that run. ms_per_frame: their time. share: of the time of all graphs.
    """

    graph: Name
    operator: Name
    calls_per_frame: Duration
    ms_per_frame: Duration
    share: Share


class MachineRecord(JsonRecord):
    """The machine. threads: of every target. affinity: the cores that the process may use.

    load_average: number of processes that wanted a core in the minute before the benchmark; None if unknown.
    """

    cpu: Name
    instruction_sets: tuple[Name, ...]
    cores: PositiveInt
    threads: PositiveInt
    affinity: tuple[int, ...]
    load_average: Duration | None
    system: Name


class FramesRecord(JsonRecord):
    """The frames that were measured. distinct: number of decoded frames, which are repeated. megabytes: of pixels."""

    source: Name
    distinct: PositiveInt
    megabytes: FiniteFloat


class BundleRecord(JsonRecord):
    """What identifies the bundle. sha256: the hash of its manifest. weights: a hash of its tensors."""

    path: Name
    preset: Name
    precision: Name
    engine: Name
    weights: Name
    sha256: Name


class BenchReport(JsonRecord):
    """The result of a benchmark.

    interrupted: whether it was ended early. The figures are then those of the completed rounds.
    maps: whether the segmenter ran.
    host_share: the share of pre- and postprocessing in the median frame.
    alternatives, ratios: by the name that was given to `--against`. skipped: by name, why one was not measured.
    """

    kind: Literal["duospacenet bench"] = REPORT_KIND
    schema_version: Literal[1] = REPORT_SCHEMA
    interrupted: bool
    machine: MachineRecord
    bundle: BundleRecord
    frames: FramesRecord
    maps: bool
    rounds: PositiveInt
    figures: TargetReport
    host_share: Share
    cold_start: ColdStartRecord
    throughput: tuple[ThroughputRecord, ...]
    alternatives: dict[Name, TargetReport]
    ratios: dict[Name, RatioRecord]
    skipped: dict[Name, Name]
    operators: tuple[OperatorRecord, ...] | None = None
