"""Changes to copies of bundles. Hashes and seal are updated, so that only the check under test can object."""

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import onnx

from duospacenet.runtime.bundle.graph_file import check_graph

GRAPHS = ("projector", "backbone", "lifter", "decoder", "segmenter")


def edit_manifest(bundle: Path, change: Callable[[dict[str, Any]], None]) -> Path:
    """Change the JSON of a bundle's manifest and seal it again."""
    manifest = json.loads((bundle / "manifest.json").read_text())
    change(manifest)
    return write_sealed_manifest(bundle, manifest)


def write_sealed_manifest(bundle: Path, manifest: dict[str, Any]) -> Path:
    """Write `manifest.json`. Its last field, the seal, is the sha256 of the lines before it."""
    unsealed = {name: value for name, value in manifest.items() if name != "sha256"}
    *lines, end = json.dumps(unsealed, indent=1).splitlines()
    body = "\n".join(lines) + ",\n"
    seal = hashlib.sha256(body.encode()).hexdigest()
    (bundle / "manifest.json").write_text(f'{body} "sha256": "{seal}"\n{end}\n')
    return bundle


def edit_graph(bundle: Path, name: str, change: Callable[[onnx.ModelProto], None]) -> Path:
    """Change one graph of a bundle and update its hash in the manifest."""
    path = bundle / f"{name}.onnx"
    model = onnx.load(path)
    change(model)
    path.write_bytes(model.SerializeToString())
    return update_graph_hash(bundle, name)


def update_graph_hash(bundle: Path, name: str) -> Path:
    """Store the present hash of a graph file in the manifest."""
    digest = hashlib.sha256((bundle / f"{name}.onnx").read_bytes()).hexdigest()
    return edit_manifest(bundle, lambda manifest: manifest["graphs"][name].update(sha256=digest))


def check_file(path: Path) -> dict[str, int]:
    """Check one graph file and return its operator sets. Raises ArtifactError."""
    return check_graph(path.read_bytes(), path)
