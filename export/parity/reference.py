"""The model in eager mode, frame by frame, with a memory of its own: what a bundle is compared with."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from ...model import DuoSpaceNet
from ...model.window import Window
from ...runtime import Frame
from ...runtime.bundle.manifest import GraphName, Preprocessing, slot_name
from ...runtime.geometry import inverse, nearest_rigid
from ...runtime.preprocessing import NetworkInputs, prepare_inputs
from ..graphs import Graph, build_graphs, memory_names


class Run(NamedTuple):
    """What one graph's module took and gave, by name."""

    inputs: dict[str, Tensor]
    outputs: dict[str, Tensor]


class EagerReference:
    """Runs the graphs' own modules in torch. It is told which frames a window holds; the poses and times it works
    out itself.
    """

    def __init__(self, model: DuoSpaceNet, preprocessing: Preprocessing) -> None:
        self.config = model.config
        self.graphs: dict[GraphName, Graph] = {graph.name: graph for graph in build_graphs(model)}
        self._preprocessing = preprocessing
        self._memory: dict[int, tuple[NetworkInputs, dict[str, Tensor]]] = {}

    def step(self, frames: Sequence[Frame], window: Sequence[int]) -> dict[str, Run]:
        """Run every graph for the newest frame of `window` (indices into `frames`, newest first)."""
        now = frames[window[0]]
        prepared = prepare_inputs(now, self._preprocessing, self.config.num_cameras)
        tensors = {name: torch.from_numpy(array) for name, array in prepared._asdict().items()}
        runs: dict[str, Run] = {}
        for name in (name for name in self.graphs if name != "decoder"):
            runs[name] = self._run(name, tensors)
            tensors |= runs[name].outputs
        self._remember(window, prepared, tensors)
        runs["decoder"] = self._run("decoder", self._decoder_inputs(frames, window))
        return runs

    def _run(self, name: GraphName, tensors: dict[str, Tensor]) -> Run:
        graph = self.graphs[name]
        inputs = {key: tensors[key] for key in graph.inputs}
        return Run(inputs, graph(inputs))

    def _remember(self, window: Sequence[int], prepared: NetworkInputs, tensors: dict[str, Tensor]) -> None:
        values = {name: tensors[name] for name in memory_names(self.config)}
        self._memory = {index: held for index, held in self._memory.items() if index in window}
        self._memory[window[0]] = prepared, values

    def _decoder_inputs(self, frames: Sequence[Frame], window: Sequence[int]) -> dict[str, Tensor]:
        specs, now = self.graphs["decoder"].inputs, frames[window[0]]
        inputs = {
            name: torch.zeros(spec.shape, dtype=spec.dtype) for name, spec in specs.items() if name in Window._fields
        }
        inputs["past_T_now"][:] = torch.eye(4)
        for slot, index in enumerate(window):
            then, (prepared, values) = frames[index], self._memory[index]
            past_T_now = inverse(nearest_rigid(then.global_T_ego)) @ nearest_rigid(now.global_T_ego)
            facts = {
                "image_T_ego": torch.from_numpy(prepared.image_T_ego),
                "camera_valid": torch.from_numpy(prepared.camera_valid),
                "frame_valid": torch.tensor(True),
                "past_T_now": torch.from_numpy(past_T_now) if slot > 0 else torch.eye(4),
                "time_delta_s": torch.tensor(now.timestamp_s - then.timestamp_s),
            }
            for name in facts.keys() & inputs.keys():
                inputs[name][slot] = facts[name]
            inputs |= {slot_name(slot, name): value for name, value in values.items()}
        return {name: torch.zeros(spec.shape) if name not in inputs else inputs[name] for name, spec in specs.items()}
