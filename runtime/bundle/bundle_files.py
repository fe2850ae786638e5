"""The graph files of a bundle: each is read once, and its bytes are checked against the manifest."""

import hashlib
from pathlib import Path

from ..errors import ArtifactError
from ..files import read_regular_file
from .graph_file import MAX_FILE_BYTES, check_graph
from .manifest import MANIFEST_NAME, GraphName, Manifest


def read_graphs(bundle: Path, manifest: Manifest) -> dict[GraphName, bytes]:
    """Read and check every graph file: its size and hash, and its content by the rules of `graph_file`.

    Returns the bytes that were checked. onnxruntime gets these, so that no file can be exchanged after its check.
    Raises ArtifactError, naming the file.
    """
    return {name: _read_graph(bundle, manifest, name) for name in manifest.graphs}


def check_files(bundle: Path, manifest: Manifest) -> None:
    """Check every graph file as `read_graphs` does, one after the other. Raises ArtifactError, naming the file."""
    for name in manifest.graphs:
        _read_graph(bundle, manifest, name)


def _read_graph(bundle: Path, manifest: Manifest, name: GraphName) -> bytes:
    graph = manifest.graphs[name]
    path = bundle / graph.file
    if not path.exists():
        raise ArtifactError(f"{path}: the bundle's {name} graph is missing. Copy the whole folder, or export again.")
    content = read_regular_file(path, MAX_FILE_BYTES, ArtifactError)
    digest = hashlib.sha256(content).hexdigest()
    if digest != graph.sha256:
        raise ArtifactError(
            f"{path}: field graphs.{name}.sha256: expected {graph.sha256[:12]!r}…, got {digest[:12]!r}…. "
            "The file is damaged or belongs to another bundle: copy the whole folder, or export again."
        )
    opsets = check_graph(content, path)
    if manifest.schema_version > 1 and opsets != graph.opsets:
        raise ArtifactError(f"{path}: opsets: {MANIFEST_NAME} says {graph.opsets}; it has {opsets}. Export again.")
    return content
