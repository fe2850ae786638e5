"""The parity report in a bundle's manifest: how far its graphs are from the PyTorch model, measured at export."""

from typing import Annotated

from pydantic import Field

from ..json_record import FiniteFloat, Flag, Integer, JsonRecord

Number = FiniteFloat | None  # None if the measured value is not finite


class TensorErrorRecord(JsonRecord):
    """The largest error of one graph output. The graph's inputs come from eager PyTorch or are random.

    absolute: largest absolute difference, in the unit of the output.
    relative: largest absolute difference divided by the RMS of the reference.
    cosine: cosine similarity of output and reference as vectors.
    frame: index of the frame; None on random inputs.
    seed: of the random inputs; None on a frame. Since schema 3.
    rms: RMS of the difference divided by the RMS of the reference. Since schema 4.
    quantized: whether the graph is quantized. Then `rms` is compared with the tolerance, otherwise `relative`.
        Since schema 4.
    """

    absolute: Number
    relative: Number
    cosine: FiniteFloat
    frame: Integer | None
    seed: Integer | None = None
    rms: Number = None
    quantized: Flag = False


class FrameErrorRecord(JsonRecord):
    """The error of one frame of a stream, in which the bundle uses its own cached values of past frames.

    window: number of frames that the reference used.
    boxes: number of detections of the bundle.
    unmatched: boxes of either side without a counterpart of the same query and class on the other.
    box: largest difference of any number of a matched box [m, rad, m/s].
    score, map: largest difference of a score or of a map probability.
    history: number of frames that the bundle used, minus `window`.
    mean_position_m: mean distance between the centres of a box [m], weighted with the reference's scores.
    mean_score: sum of the differences of the scores, divided by the sum of the reference's scores.
    mean_map: mean difference of a map probability.

    The means exist since schema 4. An int8 bundle is judged by them, not by the largest differences.
    """

    window: Integer
    boxes: Integer
    unmatched: Integer
    box: Number
    score: Number
    map: Number
    history: Integer
    mean_position_m: Number = None
    mean_score: Number = None
    mean_map: Number = None


class QuantizedTolerances(JsonRecord):
    """The largest accepted errors of an int8 bundle.

    graph: error `rms` of an output of a quantized graph on frames.
    dequantized: the same without rounded activations, on random inputs.
    position_m, score, map: the means of a streamed frame.
    """

    graph: FiniteFloat
    dequantized: FiniteFloat
    position_m: FiniteFloat
    score: FiniteFloat
    map: FiniteFloat


class Tolerances(JsonRecord):
    """The largest accepted errors.

    graph: error of a graph output relative to the RMS of the reference.
    random: the same on random inputs. Since schema 3.
    box: difference of a box number [m, rad, m/s].
    score: difference of a score or of a map probability.
    quantized: the tolerances of an int8 bundle; None for float32. Since schema 4.
    """

    graph: FiniteFloat
    box: FiniteFloat
    score: FiniteFloat
    random: FiniteFloat | None = None
    quantized: QuantizedTolerances | None = None


class CoverageRecord(JsonRecord):
    """What the stress sequence exercises.

    frames: number of frames. skipped: number of frames without any image.
    windows: number of frames by the length of their window.
    lost_cameras: by slot, the number of cameras that were lost there at least once.
    motion: largest motion between two frames of a window: pitch_deg, roll_deg, yaw_deg [degrees], height_m and
        distance_m [m].
    calibrations: number of different calibrations.
    resets: number of restarted windows by reason.
    dropped_frames: number of frames that follow a dropped frame.
    """

    frames: Integer
    skipped: Integer
    windows: Annotated[dict[int, Integer], Field(json_schema_extra={"propertyNames": {"pattern": "^[0-9]+$"}})]
    lost_cameras: tuple[Integer, ...]
    motion: dict[str, FiniteFloat]
    calibrations: Integer
    resets: dict[str, Integer]
    dropped_frames: Integer


class WeightMatchRecord(JsonRecord):
    """The tensors of the model that were found in the graphs by their values.

    parameters: number of tensors that the graphs use. matched: number of those that were found.
    values, matched_values: the same in single numbers.
    """

    parameters: Integer
    matched: Integer
    values: Integer
    matched_values: Integer


class RetraceRecord(JsonRecord):
    """The comparison of the graph files with a new export of the model.

    graphs: names of the compared graphs. skipped: why they were not compared; None if they were.
    """

    graphs: tuple[str, ...]
    skipped: str | None


class ParityReport(JsonRecord):
    """The comparison of the bundle with its reference.

    reference: what the bundle was compared with; None for eager PyTorch. Since schema 4.

    passed: whether every check passed. failures: one message per failed check.
    source: name of the frames. frames: their number.
    graphs: errors by graph and output. stream: end-to-end errors, one per frame.
    coverage: what the stress sequence exercises.
    random_inputs: number of random inputs by graph.
    elements: number of single elements of the inputs that were disturbed, by graph.
    wrong_elements: those that change the outputs differently, as `graph.input[place]`.
    weights: the model's tensors that were found in the graphs.
    retrace: the comparison with a new export; None in the report of an export.
    dead_inputs: `graph.input` names of inputs that no output depends on. Only in schemas 1 and 2.

    The fields from `coverage` to `retrace` exist since schema 3.
    """

    reference: str | None = None
    passed: Flag
    failures: tuple[str, ...]
    tolerances: Tolerances
    source: str
    frames: Integer
    graphs: dict[str, dict[str, TensorErrorRecord]]
    stream: tuple[FrameErrorRecord, ...]
    coverage: CoverageRecord | None = None
    random_inputs: dict[str, Integer] = Field(default_factory=dict)
    elements: dict[str, Integer] = Field(default_factory=dict)
    wrong_elements: tuple[str, ...] = ()
    weights: WeightMatchRecord | None = None
    retrace: RetraceRecord | None = None
    dead_inputs: tuple[str, ...] = ()
