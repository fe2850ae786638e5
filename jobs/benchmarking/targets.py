"""What a benchmark measures: the bundle and its alternatives, by the names that `--against` takes."""

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Literal, get_args

from ...runtime.bundle.manifest import DeformableForm, GraphSpec, read_manifest
from ...runtime.engine import EngineName, choose_engine
from ...runtime.errors import MissingExtraError, UsageError
from ...runtime.json_record import JsonRecord
from ...runtime.printable import printable

PeerName = Literal["eager", "compile", "stateless", "openvino"]
PEERS: tuple[PeerName, ...] = get_args(PeerName)
TORCH_PEERS: tuple[PeerName, ...] = ("eager", "compile")
GRAPH_PEERS: tuple[PeerName, ...] = ("stateless", "openvino")

PEER_DESCRIPTIONS = {
    "eager": "PyTorch, stateless over the window",
    "compile": "torch.compile, stateless over the window",
    "stateless": "one ONNX graph over the window, onnxruntime",
    "openvino": "the same graph, OpenVINO at its default precision",
}


class Target(JsonRecord):
    """Something to measure. The process that measures it gets this record as JSON.

    kind: "bundle", or a peer, which has the model of `bundle`.
    engine, engine_precision: of a bundle, as for `Pipeline.load`.
    weights: checkpoint of a peer in PyTorch; None for random weights.
    graph, graph_spec, graph_dcn: file and description of the stateless ONNX graph, and its form of the deformable
        convolutions.
    frames: pickled frames, written by the benchmark.
    """

    name: str
    kind: Literal["bundle", "eager", "compile", "stateless", "openvino"]
    bundle: Path
    threads: int
    engine: EngineName = "onnxruntime"
    engine_precision: Literal["float32", "default"] = "float32"
    weights: Path | None = None
    graph: Path | None = None
    graph_spec: GraphSpec | None = None
    graph_dcn: DeformableForm | None = None
    frames: Path | None = None


def parse_alternatives(against: Sequence[str], bundle: Target) -> list[Target]:
    """The alternatives that `--against` names: peers, bundle folders, and bundle folders with an engine.

    against: names; each may be a list with commas.
    Raises UsageError for an unknown name or one that is given twice, MissingExtraError for a peer without its library,
    and ArtifactError for a folder that is not a bundle.
    """
    names = [name for entry in against for name in _split(entry)]
    for name in names:
        if names.count(name) > 1:
            raise UsageError(f"--against: expected each alternative once; got {name!r} twice. Leave one out.")
    return [_parse(name, bundle) for name in names]


def describe_target(target: Target) -> str:
    """One line on a target: the form, the model, the precision, the weights."""
    manifest = read_manifest(target.bundle)
    if target.kind != "bundle":
        weights = printable(target.weights.name) if target.weights else "random weights"
        return f"{PEER_DESCRIPTIONS[target.kind]}; {weights}"
    trained = {True: "trained", False: "random weights", None: "weights of unknown origin"}[manifest.weights.trained]
    engine = "" if target.engine == "onnxruntime" else f", precision {target.engine_precision}"
    return f"{printable(manifest.preset)}, {manifest.precision}, {trained}; {target.engine}{engine}"


def _split(entry: str) -> list[str]:
    """The names in a list with commas. A folder with commas in its name is one name."""
    return [entry] if Path(entry).is_dir() else [name.strip() for name in entry.split(",")]


def _parse(name: str, bundle: Target) -> Target:
    if name in PEERS:
        _check_installed(name)
        return bundle.model_copy(update={"name": name, "kind": name})
    engine, separator, folder = name.partition(":")
    if separator and engine in get_args(EngineName):
        choose_engine(engine)
    else:
        engine, folder = bundle.engine, name
    if not folder or not Path(folder).is_dir():
        raise UsageError(
            f"--against: expected {', '.join(PEERS)}, or the folder of a bundle; got {name!r}. "
            "Separate several by commas."
        )
    read_manifest(Path(folder))
    return bundle.model_copy(update={"name": name, "bundle": Path(folder), "engine": engine})


def _check_installed(peer: str) -> None:
    """Raise MissingExtraError if the libraries of a peer are not installed. They are not imported."""
    needed = {"torch": "export", "onnxscript": "export"} | ({"openvino": "openvino"} if peer == "openvino" else {})
    for package, extra in needed.items():
        if find_spec(package) is None:
            raise MissingExtraError(
                f"--against {peer}: expected the package {package} from the extra '{extra}'; it is not installed. "
                f"Install it: pip install 'duospacenet[{extra}]'"
            )
