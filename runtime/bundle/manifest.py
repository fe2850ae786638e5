"""The bundle's manifest: the whole contract between export and runtime, as `manifest.json` holds it.

Schema 2 seals it: the last field, `sha256`, is that of all lines before it (`head -n -2 manifest.json | sha256sum`).
"""

import hashlib
import math
from pathlib import Path
from typing import Any, Final, Literal, get_args

from pydantic import Field

from ..errors import ArtifactError
from ..files import write_atomically
from ..json_record import FiniteFloat, JsonRecord, PositiveFloat, PositiveInt, read_json
from .graph_file import check_graph_file, check_size
from .parity_report import ParityReport

SCHEMA_VERSION: Final = 2
MANIFEST_NAME = "manifest.json"
GraphName = Literal["projector", "backbone", "lifter", "decoder", "segmenter"]
# Limits of the temporal window. nuScenes' key frames come at 2 Hz. No road vehicle drives 70 m/s or turns 180 degrees
# in a second, so a larger ego motion means that the poses belong to different drives.
NOMINAL_TIME_DELTA_S: Final = 0.5
LARGEST_TIME_DELTA_S: Final = 2.0
LARGEST_SPEED_M_S: Final = 70.0
LARGEST_TURN_RAD_S: Final = math.pi
DeformableForm = Literal["native", "grid-sample"]  # DeformConv, or what is left when it is taken apart
GRAPH_NAMES: tuple[GraphName, ...] = get_args(GraphName)
# A bundle may do without the others; each of them needs those named here.
_ALWAYS: tuple[GraphName, ...] = ("backbone", "decoder")
_NEEDED_BY: dict[GraphName, tuple[GraphName, ...]] = {
    "projector": ("lifter",),
    "lifter": ("projector",),
    "segmenter": ("projector", "lifter"),
}


class TensorSpec(JsonRecord):
    """A named tensor. Every dimension is static."""

    name: str
    shape: tuple[PositiveInt, ...]
    dtype: Literal["float32", "uint8", "bool"]


class GraphSpec(JsonRecord):
    """One graph file, in the bundle's folder. opsets: the operators' version by domain (since schema 2)."""

    file: str
    sha256: str
    inputs: tuple[TensorSpec, ...]
    outputs: tuple[TensorSpec, ...]
    opsets: dict[str, PositiveInt] = Field(default_factory=dict)


class Preprocessing(JsonRecord):
    """From a camera's picture to the backbone's input.

    The picture is scaled so that it covers width × height, and cut: the sides equally, of the height only the top.
    Intrinsics follow. The normalisation is part of the graph and stands here for information.
    """

    width_px: PositiveInt
    height_px: PositiveInt
    colour_order: Literal["bgr"]
    resize_shrinking: Literal["area"]
    resize_enlarging: Literal["linear"]
    crop: Literal["centre columns, bottom rows"]
    normalisation_in_graph: dict[str, Any]


class TemporalWindow(JsonRecord):
    """How many frames the decoder looks at, and what breaks the history."""

    num_frames: PositiveInt
    nominal_time_delta_s: PositiveFloat
    largest_time_delta_s: PositiveFloat
    largest_speed_m_s: PositiveFloat
    largest_turn_rad_s: PositiveFloat = LARGEST_TURN_RAD_S  # since schema 2


class PerceptionRange(JsonRecord):
    """The box of the ego frame that the BEV features and map masks cover, in X×Y×Z voxels."""

    size: tuple[PositiveInt, PositiveInt, PositiveInt]
    lower_m: tuple[FiniteFloat, FiniteFloat, FiniteFloat]
    upper_m: tuple[FiniteFloat, FiniteFloat, FiniteFloat]


class CheckpointRecord(JsonRecord):
    """How the tensors of a checkpoint became the model's.

    layout: whose names it has; wrappers: what stood around them, from the outside in. matched: how many tensors of the
    model it filled. missing: the pattern that allowed it, by tensor; these were drawn at random from `seed`.
    left_aside: the file's tensors of other parts, and copies of the weights that were not taken.
    """

    layout: Literal["own", "torchvision", "vovnet", "mmdetection3d"]
    wrappers: tuple[str, ...]
    matched: PositiveInt
    missing: dict[str, str]
    seed: int | None
    left_aside: tuple[str, ...]
    notes: tuple[str, ...]


class AnchorsFileRecord(JsonRecord):
    """The file of anchors that the queries' pose vectors start from."""

    file: str
    sha256: str


class WeightsRecord(JsonRecord):
    """Where the weights came from: a file, or a seed.

    sha256: of the tensors with their names, whatever file they came in; file_sha256: of that file.
    trained: whether they are; None where the file does not say, and false where some were drawn.
    anchors: given beside them, for poses that no file had.
    """

    source: str
    sha256: str
    file_sha256: str | None = None
    trained: bool | None
    checkpoint: CheckpointRecord | None = None
    anchors: AnchorsFileRecord | None = None


class Manifest(JsonRecord):
    """`manifest.json`. `memory` names what a frame leaves behind: outputs of the backbone and lifter graphs which
    the decoder takes as `slot{t}.{name}`, t frames later, t = 0 .. num_frames - 1. Schema 1 has no seal `sha256`.
    `dcn`: the form of the deformable convolutions in the graphs; None where there are none.
    """

    schema_version: Literal[1, 2]
    versions: dict[str, str]
    preset: str
    config: dict[str, Any]
    classes: tuple[str, ...]
    map_classes: tuple[str, ...]
    num_cameras: PositiveInt
    preprocessing: Preprocessing
    window: TemporalWindow
    perception: PerceptionRange
    frames_of_reference: dict[str, str]
    tensors: dict[str, str]
    memory: tuple[str, ...]
    precision: Literal["float32"]
    dcn: DeformableForm | None = None
    weights: WeightsRecord
    graphs: dict[GraphName, GraphSpec]
    parity: ParityReport | None = None
    sha256: str | None = None


def read_manifest(bundle: Path) -> Manifest:
    """Read and check `manifest.json` of a bundle folder, and its seal.

    Raises ArtifactError, naming the file and the field.
    """
    if not bundle.is_dir():
        got = "a file" if bundle.exists() else "no such folder"
        raise ArtifactError(f"{bundle}: expected a bundle folder; got {got}. See `duospacenet export`.")
    path = bundle / MANIFEST_NAME
    version = read_json(path, _Versioned, ArtifactError).schema_version
    if version > SCHEMA_VERSION:
        raise ArtifactError(
            f"{path}: field schema_version: expected at most {SCHEMA_VERSION}; got {version}. "
            "The bundle is newer than this toolkit: update the toolkit, or export again."
        )
    manifest = read_json(path, Manifest, ArtifactError)
    _check_seal(path, manifest)
    _check_graphs(path, manifest)
    return manifest


def write_manifest(bundle: Path, manifest: Manifest) -> None:
    """Write `manifest.json`, sealed. Raises OutputError."""
    text = manifest.model_dump_json(indent=2, exclude={"sha256"}).removesuffix("\n}") + ",\n"
    seal = hashlib.sha256(text.encode()).hexdigest()
    write_atomically(bundle / MANIFEST_NAME, f'{text}  "sha256": "{seal}"\n}}\n'.encode())


def check_files(bundle: Path, manifest: Manifest) -> None:
    """Hold every graph file against the manifest, and look into the graphs.

    Raises ArtifactError, naming the file.
    """
    for name, graph in manifest.graphs.items():
        if Path(graph.file).name != graph.file:
            raise ArtifactError(
                f"{bundle / MANIFEST_NAME}: field graphs.{name}.file: expected a name in the bundle's folder; "
                f"got {graph.file!r}."
            )
        path = bundle / graph.file
        if not path.is_file():
            raise ArtifactError(
                f"{path}: the bundle's {name} graph is missing. Copy the whole folder, or export again."
            )
        check_size(path)
        digest = sha256(path)
        if digest != graph.sha256:
            raise ArtifactError(
                f"{path}: field graphs.{name}.sha256: expected {graph.sha256[:12]}…, got {digest[:12]}…. "
                "The file is damaged or of another bundle: copy the whole folder, or export again."
            )
        opsets = check_graph_file(path)
        if manifest.schema_version > 1 and opsets != graph.opsets:
            raise ArtifactError(f"{path}: opsets: {MANIFEST_NAME} says {graph.opsets}; it has {opsets}. Export again.")


def slot_name(slot: int, name: str) -> str:
    """The decoder's input for what the frame `slot` frames ago left in memory as `name`."""
    return f"slot{slot}.{name}"


def sha256(path: Path) -> str:
    """The sha256 of a file, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _check_graphs(path: Path, manifest: Manifest) -> None:
    """Whether all that a frame passes is there: of BEV and maps all or nothing."""
    needed = dict.fromkeys(_ALWAYS, "always")
    for graph in manifest.graphs:
        needed |= dict.fromkeys(_NEEDED_BY.get(graph, ()), f"beside {graph}")
    for name, when in needed.items():
        if name not in manifest.graphs:
            raise ArtifactError(f"{path}: field graphs: expected {name}, {when}; it is missing. Export again.")


def _check_seal(path: Path, manifest: Manifest) -> None:
    if manifest.schema_version == 1:
        return
    lines = path.read_bytes().splitlines(keepends=True)
    expected, got = hashlib.sha256(b"".join(lines[:-2])).hexdigest(), manifest.sha256 or "none"
    if expected != got:
        raise ArtifactError(
            f"{path}: field sha256: expected {expected[:12]}…, by the lines before it; got {got[:12]}…. "
            "The file is damaged, or was edited: copy the whole folder, or export again."
        )


class _Versioned(JsonRecord, extra="ignore"):
    schema_version: int
