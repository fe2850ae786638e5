"""A float32 bundle as the reference of an int8 bundle that was made from it."""

from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor

from ...model import DuoSpaceNet, DuoSpaceNetConfig
from ...runtime import Pipeline
from ...runtime.bundle.manifest import GraphName
from ...runtime.errors import ArtifactError
from ...runtime.session import to_tensors
from .reference import EagerReference, GraphRun


class BundleReference(EagerReference):
    """Runs the graphs of a float32 bundle frame by frame, with the window and the preprocessing of its configuration.

    The bundle has been compared with PyTorch at its export.
    """

    def __init__(self, bundle: Path, pipeline: Pipeline, config: DuoSpaceNetConfig) -> None:
        """bundle: the float32 bundle. pipeline: it, loaded. config: its configuration.

        Raises ArtifactError if the toolkit of today divides this configuration into other graphs.
        """
        super().__init__(DuoSpaceNet(config))  # only the names and shapes of its graphs are used
        self._sessions = pipeline.sessions
        for name, graph in self.graphs.items():
            spec = pipeline.manifest.graphs.get(name)
            got = {tensor.name for tensor in (*spec.inputs, *spec.outputs)} if spec else set()
            if got != {*graph.inputs, *graph.outputs}:
                raise ArtifactError(
                    f"{bundle}: expected the {name} graph of this version of the toolkit; got other inputs or outputs. "
                    "Export the bundle again."
                )

    def run(self, name: GraphName, tensors: Mapping[str, Tensor]) -> GraphRun:
        """Run one graph. tensors: its inputs by name; others are ignored."""
        inputs = {key: tensors[key] for key in self.graphs[name].inputs}
        arrays = {key: value.contiguous().numpy() for key, value in inputs.items()}
        outputs = self._sessions[name].run(to_tensors(**arrays))
        return GraphRun(inputs, {key: torch.from_numpy(value.numpy()) for key, value in outputs.items()})
