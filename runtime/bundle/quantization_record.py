"""The quantization record in an int8 bundle's manifest: how it was made, and what the rounding costs."""

from typing import Annotated, Literal

from pydantic import Field

from ..json_record import FiniteFloat, JsonRecord, Name, PositiveInt

Fraction = Annotated[float, Field(strict=True, ge=0, le=1)]
Count = Annotated[int, Field(strict=True, ge=0)]
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class QuantizationRecipe(JsonRecord):
    """How the graphs were quantized.

    form: "QDQ": QuantizeLinear and DequantizeLinear around the operators.
    activations: unsigned 8 bits, one scale and zero point per tensor.
    weights: signed 8 bits, one scale per output channel, and no zero point.
    operators: the quantized operators.
    calibration: "min-max": the range of a tensor is that of its values on the calibration frames.
    onnxruntime: version of the package that quantized.
    """

    form: Literal["QDQ"]
    activations: Literal["uint8"]
    weights: Literal["int8 per channel"]
    operators: tuple[str, ...]
    calibration: Literal["min-max"]
    onnxruntime: Name


class FramesRecord(JsonRecord):
    """The frames of a measurement. sources: the identities of the sources. frames: number of frames."""

    sources: tuple[Name, ...]
    frames: PositiveInt


class MetricsRecord(JsonRecord):
    """nuScenes metrics. map_iou: by map class; empty if the sources or the bundle have no maps."""

    mAP: Fraction
    NDS: Fraction
    map_iou: dict[str, Fraction]


class MetricsByVariant(JsonRecord):
    """The metrics of the float32 bundle and of the int8 bundle: with all arithmetic in float32, and in the engine."""

    float32: MetricsRecord
    simulated: MetricsRecord
    engine: MetricsRecord


class AgreementRecord(JsonRecord):
    """The agreement of a quantized bundle's detections with those of the float32 bundle, without ground truth.

    boxes: detections of the float32 bundle with a score of at least 0.1.
    matched: fraction of these with a detection of the same class whose centre is at most 1 m away. 1 if there are none.
    score: mean absolute difference of the scores of matched detections.
    position_m: mean distance of their centres [m].
    """

    boxes: Count
    matched: Fraction
    score: FiniteFloat
    position_m: FiniteFloat


class AgreementByVariant(JsonRecord):
    """The agreement of the int8 bundle with the float32 bundle: with all arithmetic in float32, and in the engine."""

    simulated: AgreementRecord
    engine: AgreementRecord


class QuantizationRecord(JsonRecord):
    """How an int8 bundle was made from a float32 bundle. Since schema 4.

    float_manifest_sha256: hash of the float32 bundle's `manifest.json`.
    calibration: the frames that gave the ranges.
    judging: other frames, on which the bundles were compared.
    quantized_blocks, float_blocks: names of the parts of the model that were quantized, and of those that were not
        although their operators can be.
    metrics: None with `--no-metrics`.
    agreement: with the float32 bundle.
    """

    float_manifest_sha256: Sha256
    recipe: QuantizationRecipe
    calibration: FramesRecord
    judging: FramesRecord
    quantized_blocks: tuple[Name, ...]
    float_blocks: tuple[Name, ...]
    metrics: MetricsByVariant | None
    agreement: AgreementByVariant
