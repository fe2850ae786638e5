"""A float32 bundle as the reference of an int8 bundle that was made from it."""

from collections.abc import Mapping

import torch
from torch import Tensor

from ...model import DuoSpaceNet, DuoSpaceNetConfig
from ...runtime import Pipeline
from ...runtime.bundle.manifest import GraphName
from ...runtime.session import to_tensors
from .reference import EagerReference, GraphRun


class BundleReference(EagerReference):
    """Runs the graphs of a float32 bundle frame by frame, with the window and the preprocessing of its configuration.

    The bundle has been compared with PyTorch at its export.
    """

    def __init__(self, pipeline: Pipeline, config: DuoSpaceNetConfig) -> None:
        """pipeline: the loaded float32 bundle. config: its configuration."""
        super().__init__(DuoSpaceNet(config))  # only the names and shapes of its graphs are used
        self._sessions = pipeline.sessions

    def run(self, name: GraphName, tensors: Mapping[str, Tensor]) -> GraphRun:
        """Run one graph. tensors: its inputs by name; others are ignored."""
        inputs = {key: tensors[key] for key in self.graphs[name].inputs}
        arrays = {key: value.contiguous().numpy() for key, value in inputs.items()}
        outputs = self._sessions[name].run(to_tensors(**arrays))
        return GraphRun(inputs, {key: torch.from_numpy(value.numpy()) for key, value in outputs.items()})
