"""The parity report as a bundle carries it: what was measured when it was exported."""

from ..json_record import JsonRecord

Number = float | None  # None for what was not finite


class TensorErrorRecord(JsonRecord):
    """One output of one graph, on eager's inputs: the worst of all frames, and which frame that was."""

    absolute: Number
    relative: Number
    cosine: float
    frame: int


class FrameErrorRecord(JsonRecord):
    """One streamed frame. window: frames it looked at; history: frames it looked at less those it should have."""

    window: int
    boxes: int
    unmatched: int
    box: Number
    score: Number
    map: Number
    history: int


class Tolerances(JsonRecord):
    """graph: of an error relative to the reference's RMS; box [m, rad, m/s]; score and map: of probabilities."""

    graph: float
    box: float
    score: float


class ParityReport(JsonRecord):
    """Eager mode and the bundle side by side over the frames of `source`."""

    passed: bool
    failures: tuple[str, ...]
    tolerances: Tolerances
    source: str
    frames: int
    graphs: dict[str, dict[str, TensorErrorRecord]]
    stream: tuple[FrameErrorRecord, ...]
    dead_inputs: tuple[str, ...]
