"""The parity report in a bundle's manifest: how far its graphs are from the PyTorch model, measured at export."""

from ..json_record import JsonRecord

Number = float | None  # None if the measured value is not finite


class TensorErrorRecord(JsonRecord):
    """The error of one graph output, in the frame where it is largest. The graph's inputs come from eager PyTorch.

    absolute: largest absolute difference, in the unit of the output.
    relative: largest absolute difference divided by the RMS of the reference.
    cosine: cosine similarity of output and reference as vectors.
    frame: index of that frame.
    """

    absolute: Number
    relative: Number
    cosine: float
    frame: int


class FrameErrorRecord(JsonRecord):
    """The error of one frame of a stream, in which the bundle uses its own cached values of past frames.

    window: number of frames that the reference used.
    boxes: number of detections of the bundle.
    unmatched: boxes of either side without a counterpart of the same query and class on the other.
    box: largest difference of any number of a matched box [m, rad, m/s].
    score, map: largest difference of a score or of a map probability.
    history: number of frames that the bundle used, minus `window`.
    """

    window: int
    boxes: int
    unmatched: int
    box: Number
    score: Number
    map: Number
    history: int


class Tolerances(JsonRecord):
    """The largest accepted errors.

    graph: error of a graph output relative to the RMS of the reference.
    box: difference of a box number [m, rad, m/s].
    score: difference of a score or of a map probability.
    """

    graph: float
    box: float
    score: float


class ParityReport(JsonRecord):
    """The comparison of the bundle with eager PyTorch over a stress sequence.

    passed: whether every check passed. failures: one message per failed check.
    source: name of the sequence. frames: its length.
    graphs: errors by graph and output. stream: end-to-end errors, one per frame.
    dead_inputs: `graph.input` names of inputs that no output depends on.
    """

    passed: bool
    failures: tuple[str, ...]
    tolerances: Tolerances
    source: str
    frames: int
    graphs: dict[str, dict[str, TensorErrorRecord]]
    stream: tuple[FrameErrorRecord, ...]
    dead_inputs: tuple[str, ...]
