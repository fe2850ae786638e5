"""The manifest of a bundle, `manifest.json`: all information that is needed to run the graphs.

Since schema 2 it has a seal: the last field, `sha256`, is the hash of all lines before it
(`head -n -2 manifest.json | sha256sum`). The seal detects damage. It does not prove the origin.
"""

import hashlib
import math
import re
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import Field, field_validator
from pydantic_core import PydanticCustomError

from ..errors import ArtifactError
from ..files import read_regular_file, write_atomically
from ..json_record import FiniteFloat, Flag, Integer, JsonRecord, PositiveInt, check_record, parse_json
from .golden_record import GoldenRecord
from .model_config import ModelConfig
from .output_records import Axes, BoxLayout, DetectionSelection, MapLayout
from .parity_report import ParityReport
from .preprocessing_record import Length, Preprocessing
from .quantization_record import QuantizationRecord
from .schema_versions import (
    FIRST_COMPLETE_VERSION,
    SCHEMA_VERSION,
    DescribedBy,
    Since,
    check_fields_of_version,
    later_field_error,
)
from .temporal_window import Count, TemporalWindow

MANIFEST_NAME = "manifest.json"

# Limits far above every preset. Without them, a manifest could ask for any amount of memory and time.
MAX_MANIFEST_BYTES = 2**24
MAX_TENSOR_ELEMENTS = 2**29  # 2 GiB of float32

Precision = Literal["float32", "int8"]
LayoutName = Literal["own", "torchvision", "vovnet", "mmdetection3d"]  # the naming scheme of a checkpoint's tensors
DeformableForm = Literal["native", "grid-sample"]  # ONNX's DeformConv, or its decomposition into GridSample
AttentionForm = Literal["compact", "grid-sample"]  # of PV attention and lifting

GraphName = Literal["projector", "backbone", "lifter", "decoder", "segmenter"]
GRAPH_NAMES: tuple[GraphName, ...] = get_args(GraphName)
REQUIRED_GRAPHS: tuple[GraphName, ...] = ("backbone", "decoder")  # the other graphs are optional
GRAPH_DEPENDENCIES: dict[GraphName, tuple[GraphName, ...]] = {  # by graph, the graphs that it needs
    "projector": ("lifter",),
    "lifter": ("projector",),
    "segmenter": ("projector", "lifter"),
}


class TensorSpec(JsonRecord):
    """Name, static shape and dtype of a graph's input or output."""

    name: str
    shape: Annotated[tuple[PositiveInt, ...], Field(json_schema_extra={"maxItems": 8})]
    dtype: Literal["float32", "uint8", "bool"]

    @field_validator("shape")
    @classmethod
    def _check_elements(cls, shape: tuple[int, ...]) -> tuple[int, ...]:
        if len(shape) > 8 or math.prod(shape) > MAX_TENSOR_ELEMENTS:
            raise PydanticCustomError("shape", f"Input should have at most 8 axes and {MAX_TENSOR_ELEMENTS} elements")
        return shape


class GraphSpec(JsonRecord):
    """One graph of the bundle.

    file: name in the bundle's folder. sha256: hash of the file.
    opsets: operator-set version by domain; "" is ONNX's own domain. Since schema 2.
    """

    file: str
    sha256: str
    inputs: tuple[TensorSpec, ...]
    outputs: tuple[TensorSpec, ...]
    opsets: Annotated[dict[str, PositiveInt], Since(2)] = Field(default_factory=dict)


class PerceptionRange(JsonRecord):
    """The part of the ego frame that the BEV features and map masks cover.

    size: number of voxels along x, y, z. lower_m, upper_m: its corners in the ego frame [m].
    """

    size: tuple[Length, Length, Length]
    lower_m: tuple[FiniteFloat, FiniteFloat, FiniteFloat]
    upper_m: tuple[FiniteFloat, FiniteFloat, FiniteFloat]


class CheckpointRecord(JsonRecord):
    """How the tensors of a checkpoint were assigned to the model.

    layout: the naming scheme of the tensors, named after its code base.
    wrappers: keys of the dictionaries around the tensors, outermost first.
    matched: number of model tensors that the checkpoint filled.
    missing: by model tensor, the `--allow-missing` pattern that permitted its absence. Missing tensors are initialised
        randomly from `seed`.
    left_aside: tensors of the file that were not used: other parts of a model, and other copies of the weights.
    notes: remarks, for example a known difference to the layout's code base.
    ignored: by tensor of the file, the `--ignore` pattern that excluded it.
    weights_key: the `--weights-key` that chose one of several copies of the weights; None if there was none.
    """

    layout: LayoutName
    wrappers: tuple[str, ...]
    matched: PositiveInt
    missing: dict[str, str]
    seed: Integer | None
    left_aside: tuple[str, ...]
    notes: tuple[str, ...]
    ignored: Annotated[dict[str, str], Since(3)] = Field(default_factory=dict)
    weights_key: Annotated[str | None, Since(3)] = None


class AnchorsFileRecord(JsonRecord):
    """The anchors file that the queries' pose vectors were initialised from."""

    file: str
    sha256: str


class WeightsRecord(JsonRecord):
    """The origin of the weights: a checkpoint file or a random seed.

    sha256: hash of the tensors and their names, independent of the file format.
    file_sha256: hash of the checkpoint file.
    trained: false if any tensor is random; None if the file does not say.
    checkpoint: how the file's tensors were assigned; None for random weights.
    anchors: the anchors file, if one was given for query poses that the checkpoint lacks.
    """

    source: str
    sha256: str
    file_sha256: str | None = None
    trained: Flag | None
    checkpoint: Annotated[CheckpointRecord | None, Since(2)] = None
    anchors: Annotated[AnchorsFileRecord | None, Since(2)] = None


class Manifest(JsonRecord):
    """The content of `manifest.json`.

    versions: of the toolkit, torch and onnx packages that exported the bundle.
    preset, config: name and full configuration of the model. The fields of `config` are those of `ModelConfig` since
        schema 5.
    classes: in the order of the class logits. map_classes: in the order of the segmenter's outputs.
    num_cameras: number of camera slots of the graphs; a rig may have fewer cameras.
    axes: directions of the axes of the coordinate frames.
    selection: how detections are selected. boxes, maps: layout of the boxes and of the map masks.
    frames_of_reference, tensors: explanations of the coordinate frames and of the graphs' tensors.
    memory: outputs of the backbone and the lifter that are cached. The decoder takes them again for each frame of
        the window, as `slot{t}.{name}` for the frame t steps ago, t = 0 .. window.num_frames - 1.
    dcn: form of the deformable convolutions in the graphs; None if there are none.
    attention: form of PV attention and of lifting in the graphs; since schema 4.
    precision: "int8" if some of the graphs are quantized; since schema 4.
    quantization: how an int8 bundle was made; None for float32. Since schema 4.
    parity: the parity report measured at export, or at the quantization of an int8 bundle.
    golden: the files of the golden example; None if the bundle has none. Since schema 5.
    sha256: the seal; since schema 2.
    """

    schema_version: Literal[1, 2, 3, 4, 5]
    versions: dict[str, str]
    preset: str
    config: Annotated[dict[str, Any], DescribedBy(ModelConfig)]
    classes: tuple[str, ...]
    map_classes: tuple[str, ...]
    num_cameras: Count
    preprocessing: Preprocessing
    window: TemporalWindow
    perception: PerceptionRange
    axes: Annotated[Axes, Since(5)] = Axes()
    selection: Annotated[DetectionSelection, Since(5)] = DetectionSelection()
    boxes: Annotated[BoxLayout, Since(5)] = BoxLayout()
    maps: Annotated[MapLayout, Since(5)] = MapLayout()
    frames_of_reference: dict[str, str]
    tensors: dict[str, str]
    memory: Annotated[tuple[str, ...], Field(max_length=256)]
    precision: Precision
    dcn: Annotated[DeformableForm | None, Since(2)] = None
    attention: Annotated[AttentionForm, Since(4)] = "grid-sample"
    weights: WeightsRecord
    graphs: dict[GraphName, GraphSpec]
    quantization: Annotated[QuantizationRecord | None, Since(4)] = None
    parity: ParityReport | None = None
    golden: Annotated[GoldenRecord | None, Since(5)] = None
    sha256: Annotated[str | None, Since(2)] = None


def read_manifest(bundle: Path) -> Manifest:
    """Read `manifest.json` of a bundle folder, and check its fields and its seal.

    Raises ArtifactError, naming the file and the field.
    """
    if not bundle.is_dir():
        got = "a file" if bundle.exists() else "no such folder"
        raise ArtifactError(f"{bundle}: expected a bundle folder; got {got}. See `duospacenet export`.")
    path = bundle / MANIFEST_NAME
    if not path.exists():
        raise ArtifactError(
            f"{bundle}: expected a bundle folder, with {MANIFEST_NAME} in it; got a folder without it. "
            "See `duospacenet export`."
        )
    content = read_regular_file(path, MAX_MANIFEST_BYTES, ArtifactError)
    values = parse_json(path, content, ArtifactError)
    version = check_record(path, values, _Versioned, ArtifactError).schema_version
    if version > SCHEMA_VERSION:
        raise ArtifactError(
            f"{path}: field schema_version: expected at most {SCHEMA_VERSION}; got {version}. "
            "The bundle is newer than this toolkit: update the toolkit, or export again."
        )
    manifest = check_record(path, values, Manifest, ArtifactError)
    _check_seal(path, content, manifest)
    check_fields_of_version(path, manifest, version)
    if version >= FIRST_COMPLETE_VERSION:
        check_record(path, {"config": manifest.config}, _WithConfig, ArtifactError)
    _check_precision(path, manifest)
    _check_graphs(path, manifest)
    return manifest


def write_manifest(bundle: Path, manifest: Manifest) -> None:
    """Write `manifest.json` with its seal. Raises OutputError."""
    text = manifest.model_dump_json(indent=2, exclude={"sha256"}).removesuffix("\n}") + ",\n"
    seal = hashlib.sha256(text.encode()).hexdigest()
    write_atomically(bundle / MANIFEST_NAME, f'{text}  "sha256": "{seal}"\n}}\n'.encode())


def graph_file_name(name: str) -> str:
    """Return the file name of a graph in the bundle's folder."""
    return f"{name}.onnx"


def slot_name(slot: int, name: str) -> str:
    """Return the decoder's input name for the cached value `name` of the frame `slot` steps ago."""
    return f"slot{slot}.{name}"


def sha256(path: Path) -> str:
    """Return the sha256 hash of a file, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _check_graphs(path: Path, manifest: Manifest) -> None:
    """Check that no graph is missing that another one needs, and that the files have the names of the graphs."""
    needed = dict.fromkeys(REQUIRED_GRAPHS, "always needed")
    for graph in manifest.graphs:
        needed |= dict.fromkeys(GRAPH_DEPENDENCIES.get(graph, ()), f"needed by {graph}")
    for name, reason in needed.items():
        if name not in manifest.graphs:
            raise ArtifactError(f"{path}: field graphs: expected {name}, {reason}; it is missing. Export again.")
    for name, spec in manifest.graphs.items():
        if spec.file != graph_file_name(name):
            # A path could name any file, and onnxruntime reads a file `*.ort` in another format.
            raise ArtifactError(
                f"{path}: field graphs.{name}.file: expected {graph_file_name(name)!r}; got {spec.file[:80]!r}."
            )


def _check_precision(path: Path, manifest: Manifest) -> None:
    """Check that exactly the bundles of precision int8 have a quantization record."""
    is_int8, has_record = manifest.precision == "int8", manifest.quantization is not None
    if is_int8 != has_record:
        expected = "the record of an int8 bundle" if is_int8 else f"null in a {manifest.precision} bundle"
        got = "a record" if has_record else "none"
        raise ArtifactError(f"{path}: field quantization: expected {expected}; got {got}. Quantize or export again.")


def _check_seal(path: Path, content: bytes, manifest: Manifest) -> None:
    """Check that the last field is the seal, and that it is the hash of all lines before it. Schema 1 has no seal."""
    if manifest.schema_version == 1:
        if "sha256" in manifest.model_fields_set:
            raise later_field_error(path, "sha256", 2, manifest.schema_version)
        return
    seal = re.fullmatch(rb'(.*,\n)[ \t]*"sha256": *"([0-9a-f]{64})"\n\}\n?', content, re.DOTALL)
    expected = hashlib.sha256(seal[1]).hexdigest() if seal else "64 hexadecimal digits as the last field"
    got = seal[2].decode() if seal else "none"
    if expected != got:
        expected, got = (f"{digits[:12]}…" if seal else digits for digits in (expected, got))
        raise ArtifactError(
            f"{path}: field sha256: expected {expected}, the hash of the lines before it; got {got}. "
            "The file is damaged or was edited: copy the whole folder, or export again."
        )


class _WithConfig(JsonRecord):
    """The configuration of the model, which older schemas do not check."""

    config: ModelConfig


class _Versioned(JsonRecord, extra="ignore"):
    """A manifest of any schema. Its version is checked first, so that a newer schema is reported as such."""

    schema_version: Annotated[int, Field(strict=True)]
