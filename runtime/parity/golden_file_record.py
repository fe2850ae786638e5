"""The description of a golden file: its cases and frames, and the names of their arrays."""

from typing import Annotated, Literal

from pydantic import Field

from ..bundle.manifest import GraphName
from ..json_record import FiniteFloat, JsonRecord, Name, PositiveInt

Count = Annotated[int, Field(strict=True, ge=0, le=2**31)]
Row3 = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Row4 = tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]


class CaseRecord(JsonRecord):
    """The inputs of one graph, and the outputs of eager PyTorch.

    name: such as `decoder/frame-3`. frame: of the stress sequence; None for random inputs. seed: of random inputs.
    inputs, outputs: by name of the tensor, the name of the array.
    heading: name of the array (Q) with the lengths of (sin θ, cos θ) of each box; None for graphs without boxes.
    """

    name: Name
    graph: GraphName
    frame: Count | None
    seed: Count | None
    inputs: dict[Name, Name]
    outputs: dict[Name, Name]
    heading: Name | None


class CameraRecord(JsonRecord):
    """A camera of a frame, as `Camera`. image: name of the array; None for a lost camera."""

    width_px: PositiveInt
    height_px: PositiveInt
    intrinsics_px: tuple[Row3, Row3, Row3]
    camera_T_ego: tuple[Row4, Row4, Row4, Row4]
    image: Name | None


class StreamFrameRecord(JsonRecord):
    """A frame of the stress sequence, and the outputs of eager PyTorch.

    window: number of frames in its window; 0 if every camera is lost, so that the frame is skipped.
    outputs: by name, the array of `class_logits`, of `boxes`, and of the logits of each map class; empty if skipped.
    heading: as in `CaseRecord`; None if skipped.
    """

    token: Name
    scene: Name
    timestamp_s: FiniteFloat
    global_T_ego: tuple[Row4, Row4, Row4, Row4]
    cameras: dict[Name, CameraRecord]
    window: Count
    outputs: dict[Name, Name]
    heading: Name | None


class GoldenFileRecord(JsonRecord):
    """The text `about` of a golden file.

    preset, weights_sha256: of the model. classes: in the order of the logits.
    cases: single graphs. stream: consecutive frames.
    """

    schema_version: Literal[1]
    preset: Name
    weights_sha256: Name
    classes: tuple[Name, ...]
    cases: tuple[CaseRecord, ...]
    stream: tuple[StreamFrameRecord, ...]
