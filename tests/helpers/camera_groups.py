"""Bundles whose backbone takes one camera at a time, as those of large images."""

import shutil
from pathlib import Path

import pytest

from duospacenet.export import graphs
from duospacenet.export.graphs import graphs_to_export
from duospacenet.export.manifest_builder import graph_spec
from duospacenet.export.tracing import trace
from duospacenet.model import DuoSpaceNet
from duospacenet.runtime.bundle.manifest import sha256
from duospacenet.runtime.bundle.operators import DEFAULT_OPSET
from tests.helpers.bundles import edit_manifest


def copy_with_one_camera_per_run(bundle: Path, model: DuoSpaceNet, folder: Path) -> Path:
    """Copy a bundle of `model` to `folder`, with another backbone. No other graph depends on the cameras per run."""
    shutil.copytree(bundle, folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(graphs, "_LARGEST_IMAGE_TOGETHER_PX", 0)  # every image counts as large
        backbone = next(graph for graph in graphs_to_export(model) if graph.name == "backbone")
    trace(backbone, folder / "backbone.onnx")
    spec = graph_spec(backbone, sha256(folder / "backbone.onnx"), DEFAULT_OPSET).model_dump(mode="json")
    return edit_manifest(folder, lambda manifest: manifest["graphs"].update(backbone=spec))
